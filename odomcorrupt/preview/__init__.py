"""What a model will do to a bag, before it is done: many runs over its clean path, nothing written."""
