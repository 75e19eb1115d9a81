"""The laser arm of the laboratory: drives with known causes and a ray-cast laser as truth instead of motion capture."""
