"""The hidden-effect laboratory: its protocol, its cases, their runs, and the page of results."""
