"""How likely what is left of a recording is, under a noise law and the truth's own noise."""
