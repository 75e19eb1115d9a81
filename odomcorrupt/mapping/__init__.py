"""Maps: reading and writing, mapping with a laser, and motion constrained by a map."""
