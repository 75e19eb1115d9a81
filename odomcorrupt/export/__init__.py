"""A model's parameters converted to those of other programs; docs/export.md derives each formula."""
