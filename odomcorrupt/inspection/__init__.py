"""Inspection of a bag: one pass over it, checks, and a summary."""
