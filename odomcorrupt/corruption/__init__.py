"""The corrupting half: odometry in blocks becomes a noisy path, the path a correction, the correction patches."""
