"""Figures and reports of results; the only package that draws."""
