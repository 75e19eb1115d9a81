"""Other sensors of the robot, whose numbers follow its motion."""
