"""The Python interface: one file for each thing that a notebook or a test does. Import its names from `odomcorrupt`."""
