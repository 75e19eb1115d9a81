"""Messages of one generation of ROS written as those of the other: types, definitions, QoS, serialisation."""
