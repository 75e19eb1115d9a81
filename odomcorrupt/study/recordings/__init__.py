"""Recordings of one robot: trajectories on their clocks, headings, what drives, what the encoders did."""
