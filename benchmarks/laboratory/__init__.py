"""The hidden-effect laboratory: its protocol, its cases, what is asked of each, and the page of its figures."""
