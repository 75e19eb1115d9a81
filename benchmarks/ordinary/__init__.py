"""The ordinary laboratory: typical user recordings from a generator that shares no code with the package."""
