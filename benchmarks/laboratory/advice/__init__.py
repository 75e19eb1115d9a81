"""The advice arm: whether following "drive X" settles what a first drive left open."""
