"""Planar geometry: poses of SE(2), odometry increments, and the motion between them."""
