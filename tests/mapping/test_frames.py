import numpy as np
import pytest

from odomcorrupt.errors import TopicError
from odomcorrupt.mapping.frames import FrameTree, _matrix


def tree(*edges):
    out = FrameTree()
    for parent, child, position, quat in edges:
        out._static[child] = (parent, _matrix(np.array(position), np.array(quat, dtype=float)))
    return out


def test_laser_over_a_common_ancestor():
    half = np.sqrt(0.5)
    mount = tree(
        ("base_footprint", "base_link", (0, 0, 0.1), (0, 0, 0, 1)),
        ("base_footprint", "tower", (0.2, 0.1, 0.3), (0, 0, half, half)),
        ("tower", "laser", (0.1, 0, 0), (0, 0, 0, 2)),  # a quaternion of length two
    ).mount("base_link", "/laser", "bag")
    np.testing.assert_allclose(mount.position_xy, [0.2, 0.2], atol=1e-12)
    np.testing.assert_allclose(mount.plane @ [1, 0], [0, 1], atol=1e-12)


def test_laser_hung_upside_down_mirrors():
    mount = tree(("base", "laser", (0, 0, 1), (1, 0, 0, 0))).mount("base", "laser", "bag")
    np.testing.assert_allclose(mount.plane @ [np.cos(0.3), np.sin(0.3)], [np.cos(0.3), -np.sin(0.3)], atol=1e-12)


def test_missing_link_and_loop_are_reported():
    with pytest.raises(TopicError, match="laser_pose"):
        tree(("a", "b", (0, 0, 0), (0, 0, 0, 1)), ("b", "a", (0, 0, 0), (0, 0, 0, 1))).mount("base", "a", "bag")
