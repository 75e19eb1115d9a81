"""The ordinary laboratory: recordings as users have them, by a generator that shares no code with the package."""
