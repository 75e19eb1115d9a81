"""One module per command: options, a call of the Python interface, and printing; no mathematics."""
