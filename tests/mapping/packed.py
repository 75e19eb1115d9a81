"""Scans, grids and transforms packed by other people's writers."""

import numpy as np

from rosmessages import header, new, pose, serialised

ROS1, ROS2 = 1, 2


def scan(ranges, store=ROS2, stamp_ns=5_000_000_007, frame="laser", time_step=1e-3):
    limits = (-0.5, 0.5, 0.25, time_step, 0.1, 0.1, 10.0)
    seen = np.asarray(ranges, dtype=np.float32), np.ones(2, dtype=np.float32)
    return serialised(store, new(store, "sensor_msgs/LaserScan", header(store, stamp_ns, frame), *limits, *seen))


def grid(cells, store=ROS2, frame="map"):
    rows, columns = cells.shape
    origin = pose(store, (1.0, -2.0, 0.0), (0.0, 0.0, np.sin(0.2), np.cos(0.2)))
    time = new(store, "builtin_interfaces/Time", 1, 2)
    info = new(store, "nav_msgs/MapMetaData", time, 0.05, columns, rows, origin)
    data = cells.astype(np.int8).ravel()
    return serialised(store, new(store, "nav_msgs/OccupancyGrid", header(store, 0, frame), info, data))
