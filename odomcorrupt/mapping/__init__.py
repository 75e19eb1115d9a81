"""Maps: read and written, drawn by laser rays, and asked where a robot can be."""
