"""The advice arm: whether following the advice "drive X" resolves the ambiguity of a first drive."""
