"""A small ray-caster: a robot drives loops in a furnished room, and a laser on it sees the walls."""

import laserbags
import numpy as np

from odomcorrupt.geometry.se2 import compose

ROOM = [(-3.2, -2.5), (4.1, -2.5), (4.1, 1.6), (2.6, 1.6), (2.6, 3.1), (-3.2, 3.1)]
BOXES = [[(-2.6, 1.7), (-1.7, 1.7), (-1.7, 2.4), (-2.6, 2.4)], [(2.4, -2.0), (3.2, -1.7), (3.0, -1.2), (2.2, -1.5)]]
CORRIDOR = [(-60.0, -1.1), (60.0, -1.1), (60.0, 1.1), (-60.0, 1.1)]

PERSON = 0.22 * np.stack([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4])


def closed(corners):
    points = np.array(corners, dtype=float)
    return np.stack((points, np.roll(points, -1, axis=0)), axis=1)


WALLS = np.concatenate([closed(ROOM), *(closed(box) for box in BOXES)])


def path(duration_s=36.0, rate_hz=20.0, *, straight=False):
    """Stamps and true poses of a drive: loops with turns both ways, or to and fro along x."""
    fine = np.arange(0.0, duration_s, 0.005)
    if straight:
        speed, turn = 0.6 * np.sin(0.5 * fine), 0.2 * np.sin(1.3 * fine)
    else:
        speed, turn = 0.35 + 0.15 * np.sin(0.7 * fine), 0.55 * np.sin(0.35 * fine) + 0.25 * np.sin(0.9 * fine + 0.5)
    yaw = np.concatenate(([0.1], 0.1 + np.cumsum(turn[:-1]) * 0.005))
    x = np.cumsum(speed * np.cos(yaw)) * 0.005
    y = np.cumsum(speed * np.sin(yaw)) * 0.005
    centre = (0.0, 0.0) if straight else (x.mean(), y.mean())
    poses = np.stack((x - centre[0], y - centre[1], yaw), axis=1)
    t_s = np.arange(0.0, duration_s - 0.01, 1.0 / rate_hz)
    return t_s, np.stack([np.interp(t_s, fine, column) for column in poses.T], axis=1), fine, poses


def there_and_back(fine, every, half_s=10.0, short_s=0.6):
    """A drive out and back in reverse along the same path, that ends a little short of where it began, and rests."""
    back = np.arange(0.0, 2.0 * half_s - short_s + 1.5, 0.005)
    along = 12.0 + np.maximum(half_s - np.abs(back - half_s), short_s * (back > half_s))
    poses = np.stack([np.interp(along, fine, column) for column in every.T], axis=1)
    t_s = np.arange(0.0, back[-1], 0.05)
    return t_s, np.stack([np.interp(t_s, back, column) for column in poses.T], axis=1), back, poses


def ranges(
    pose_at, starts_s, *, walls=WALLS, beams=180, sweep_s=0.15, flipped=False, noise=0.008, backwards=False, rng=None
):  # fmt: skip
    """Ranges (n, beams): each beam from where the laser is then; a flipped laser turns clockwise seen from above.

    backwards : the last beam is measured first, as by a laser whose driver reverses the order
    walls : (s, 2, 2), or a function that returns them for the start of a sweep
    """
    rng = np.random.default_rng(1) if rng is None else rng
    bearing = -np.pi + 2 * np.pi * np.arange(beams) / beams
    out = []
    for start in starts_s:
        beam = np.arange(beams)[::-1] if backwards else np.arange(beams)
        pose = pose_at(start + sweep_s * beam / beams)
        angle = pose[:, 2] + (-bearing if flipped else bearing)
        way = np.stack((np.cos(angle), np.sin(angle)), axis=1)
        there = walls(start) if callable(walls) else walls
        a, along = there[:, 0], there[:, 1] - there[:, 0]
        to = a[None] - pose[:, None, :2]
        cross = way[:, None, 0] * along[:, 1] - way[:, None, 1] * along[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (to[..., 0] * along[:, 1] - to[..., 1] * along[:, 0]) / cross
            share = (to[..., 0] * way[:, None, 1] - to[..., 1] * way[:, None, 0]) / cross
        met = np.where((far > 0.0) & (share >= 0.0) & (share <= 1.0), far, np.inf).min(axis=1)
        out.append(met + noise * rng.standard_normal(beams))
    return np.array(out)


def with_people(walls, pose, start_s, people_m):
    """Walls and people at distances ahead of a pose (3,), who sway from side to side."""
    way = pose[2] + 0.3 * np.sin(0.8 * start_s)
    places = [pose[:2] + far * np.array([np.cos(way), np.sin(way)]) for far in people_m]
    return np.concatenate([walls, *(closed(place + PERSON) for place in places)])


def drive(
    where, *, mount=(0.1, 0.0, 0.0), stated=None, rate_hz=5.0, sweep_s=0.15, flipped=False, corridor=False,
    jitter_s=0.0, blind=False, cloud=False, twice=False, off=1.02, spin=None, backwards=False, gyro=False,
    returns=False, scan_time_s=None, missing_s=(0.0, 0.0), people_m=(), field=False,
):  # fmt: skip
    """Write a bag of odometry (turns too far by a factor) and scans with something wrong about them.

    spin : whether the robot turns steadily "while driving" or "on the spot"
    scan_time_s : what the scans say in scan_time, with a time_increment of 0
    missing_s : when no scans are recorded, from and to
    people_m : distances ahead of the laser at which people walk with it
    field : no walls within reach
    """
    t_s, poses, fine, every = path(straight=corridor)
    if returns:
        t_s, poses, fine, every = there_and_back(fine, every)
    if spin is not None:
        every = every * (spin == "while driving")
        every[:, 2] = 0.1 + 1.2 * fine
        poses = np.stack([np.interp(t_s, fine, column) for column in every.T], axis=1)

    def laser_at(at_s):
        robot = np.stack([np.interp(at_s, fine, column) for column in every.T], axis=1)
        return compose(robot, np.array(mount))

    starts = np.arange(0.1, t_s[-1] - (0.3 if returns else 1.5), 1.0 / rate_hz)
    starts = starts[(starts < missing_s[0]) | (starts > missing_s[1])]
    walls = 10.0 * closed(ROOM) if field else closed(CORRIDOR) if corridor else WALLS
    seen = ranges(
        laser_at,
        starts,
        walls=lambda start: with_people(walls, laser_at(np.array([start]))[0], start, people_m),
        sweep_s=sweep_s,
        flipped=flipped,
        backwards=backwards,
    )
    if blind:
        seen = 0.3 + 0.002 * np.random.default_rng(2).standard_normal(seen.shape)
    odometry = poses.copy()
    odometry[:, 2] = poses[0, 2] + off * (poses[:, 2] - poses[0, 2])
    step = np.diff(poses[:, :2], axis=0)
    turn = (off - 1.0) * 0.5 * (poses[1:, 2] + poses[:-1, 2] - 2.0 * poses[0, 2])
    c, s = np.cos(turn), np.sin(turn)
    moved = np.stack((c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]), axis=1)
    odometry[1:, :2] = odometry[0, :2] + np.cumsum(moved, axis=0)
    late = np.abs(np.random.default_rng(4).standard_normal(len(starts))) * jitter_s

    def stamps(at_s):
        return laserbags.START_NS + np.round(at_s * 1e9).astype(np.int64)

    groups = [laserbags.odometry(stamps(t_s), odometry)]
    if cloud:
        bearing = -np.pi + 2 * np.pi * np.arange(seen.shape[1]) / seen.shape[1]
        points = [
            np.concatenate([np.column_stack((r * np.cos(bearing), r * np.sin(bearing), r * np.tan(tilt)))
                            for tilt in np.radians((-8.0, 0.0, 8.0))])
            for r in np.where(np.isfinite(seen), seen, np.nan)
        ]  # fmt: skip
        groups.append(laserbags.clouds(stamps(starts + 0.5 * sweep_s), points))
    else:
        turn_s, increment = (sweep_s, True) if scan_time_s is None else (scan_time_s, False)
        groups.append(laserbags.scans(stamps(starts + late), seen, turn_s=turn_s, increment=increment))
    if twice:
        groups.append(laserbags.scans(stamps(starts + 0.01), seen, "/scan_rear", turn_s=sweep_s))
    if gyro:
        rate = np.gradient(every[:, 2], fine)[::2]
        rate = rate + 0.02 * np.random.default_rng(6).standard_normal(len(rate))
        groups.append(laserbags.imu(stamps(fine[::2]), np.column_stack((0.0 * rate, 0.0 * rate, rate + 0.004))))
    if stated is not None:
        groups.append(laserbags.sits(x=stated[0], y=stated[1], yaw=stated[2]))
    return laserbags.write(where, *groups)
