"""Model selection: which terms are missing."""
