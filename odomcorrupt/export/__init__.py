"""A model's numbers in the words of other programs; each formula is derived in docs/export.md."""
