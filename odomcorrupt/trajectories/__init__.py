"""A whole drive out of a bag: its poses, its velocities, and odometry integrated from them."""
