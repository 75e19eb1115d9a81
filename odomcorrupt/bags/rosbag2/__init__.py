"""ROS 2 bags: a directory with metadata.yaml and sqlite3 or MCAP files, or one such file alone."""
