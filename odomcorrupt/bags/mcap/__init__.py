"""MCAP files: with and without chunks, indexes and summary, from files and pipes."""
