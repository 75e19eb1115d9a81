"""One thin file a command, no maths."""
