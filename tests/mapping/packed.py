"""Scans, grids and transforms packed by other people's writers."""

import numpy as np
from rosbags.typesys import Stores, get_typestore

ROS2, ROS1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)


def _header(store, stamp_ns, frame):
    time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    extra = {"seq": 3} if store is ROS1 else {}
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **extra)


def _bytes(store, message):
    name = message.__msgtype__
    return bytes(store.serialize_ros1(message, name) if store is ROS1 else store.serialize_cdr(message, name))


def scan(ranges, store=ROS2, stamp_ns=5_000_000_007, frame="laser", time_step=1e-3):
    message = store.types["sensor_msgs/msg/LaserScan"](
        header=_header(store, stamp_ns, frame), angle_min=-0.5, angle_max=0.5, angle_increment=0.25,
        time_increment=time_step, scan_time=0.1, range_min=0.1, range_max=10.0,
        ranges=np.asarray(ranges, dtype=np.float32), intensities=np.ones(2, dtype=np.float32),
    )  # fmt: skip
    return _bytes(store, message)


def grid(cells, store=ROS2, frame="map"):
    t = store.types
    time = t["builtin_interfaces/msg/Time"](1, 2)
    pose = t["geometry_msgs/msg/Pose"](
        position=t["geometry_msgs/msg/Point"](1.0, -2.0, 0.0),
        orientation=t["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(0.2), np.cos(0.2)),
    )
    rows, columns = cells.shape
    info = t["nav_msgs/msg/MapMetaData"](map_load_time=time, resolution=0.05, width=columns, height=rows, origin=pose)
    data = cells.astype(np.int8).ravel()
    return _bytes(store, t["nav_msgs/msg/OccupancyGrid"](header=_header(store, 0, frame), info=info, data=data))
