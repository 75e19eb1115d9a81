"""From recordings to a robot's model: effects, clocks and noise together, with intervals."""
