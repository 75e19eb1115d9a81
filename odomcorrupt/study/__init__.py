"""Study of recordings: reading, estimation, selection of effects, validation and experiment design."""
