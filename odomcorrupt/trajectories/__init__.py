"""Whole trajectories of a bag: poses, velocities, and odometry integrated from velocities."""
