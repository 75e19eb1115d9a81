"""The laser arm of the laboratory: drives whose answer is known, seen by a ray-cast laser instead of motion capture."""
