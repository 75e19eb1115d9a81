"""The Python interface, one module per task. Import its names from `odomcorrupt`."""
