"""A pytest plugin: corrupted bags of a clean one as a fixture, and a gate on errors of whatever was run on them.

Installed with odomcorrupt, found by pytest through its entry point. docs/how-to/pytest.md shows it at work.
"""
