"""ROS 1 bags, version 2.0: chunks of messages, none, lz4 or bz2, with their index."""
