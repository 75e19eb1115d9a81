"""Drives for the tests of this folder: clean poses in time, and a slow textbook that corrupts them."""

import math
from itertools import pairwise

import numpy as np

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.model.motion_model import MotionModel, Noise, Step
from odomcorrupt.model.noise_laws import Coefficients

LAW_COEFFICIENTS = {
    "diffusion": Coefficients(0.05, 0.03, 0.05, 0.02),
    "linear": Coefficients(0.05, 0.17, 0.05, 0.01),
    "quadratic": Coefficients(0.01, 0.02, 0.01, 0.005),
    "velocity": Coefficients(0.02, 0.03, 0.01, 0.01, end_trans=0.01, end_rot=0.02),
    "omni": Coefficients(0.02, 0.03, 0.03, 0.005, across_trans=0.01),
    "article-code": Coefficients(3.0, 2.0, 2.0, 1.0),
}


def model(law="diffusion", coefficients=None, step=None, effects=(), track_m=None):
    chosen = LAW_COEFFICIENTS[law] if coefficients is None else coefficients
    return MotionModel(Noise(law, chosen, None if step is None else Step.parse(step)), tuple(effects), track_m)


def silent(effects=(), track_m=None):
    return model(coefficients=Coefficients(0, 0, 0, 0), effects=effects, track_m=track_m)


def stamps(n, rate_hz, start_s=100):
    return start_s * 10**9 + (np.arange(n) * (10**9 / rate_hz)).astype(np.int64)


def office(rate_hz=50.0, seconds=40.0):
    """A drive with straights, bends, a stop, a turn on the spot and a reverse: stamps and poses."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    phase = t % 20.0
    v = np.select([phase < 8, phase < 10, phase < 13, phase < 17], [0.6, 0.0, 0.0, 0.5], -0.3)
    w = np.select([phase < 4, phase < 8, phase < 10, phase < 13, phase < 17], [0.0, 0.35, 0.0, -0.8, 0.1], 0.05)
    theta = 0.4 + np.concatenate(([0.0], np.cumsum(w[:-1] / rate_hz)))
    middle = theta[:-1] + w[:-1] / rate_hz / 2
    x = 2.0 + np.concatenate(([0.0], np.cumsum(v[:-1] * np.cos(middle) / rate_hz)))
    y = -1.0 + np.concatenate(([0.0], np.cumsum(v[:-1] * np.sin(middle) / rate_hz)))
    return stamps(len(t), rate_hz), np.column_stack((x, y, theta))


def error_in_any_cut(chosen, t, poses, most=80):
    """Return the errors (n, 3) of a drive; all that is said of it is the same when it comes in pieces below a size."""
    path, whole = NoisyPath(chosen, 4), NoisyPath(chosen, 4).feed(t, poses)
    ends = np.cumsum(np.random.default_rng(most).integers(0, most, 2 * len(t)))
    places = [0, *ends[ends < len(t)], len(t)]
    pieces = [path.feed(t[start:stop], poses[start:stop]) for start, stop in pairwise(places)]
    for name in ("error_xyt", "correction_xyt", "travelled_m", "sums"):
        together = np.concatenate([getattr(piece, name) for piece in pieces], axis=-1 if name == "sums" else 0)
        assert np.array_equal(together, getattr(whole, name)), name
    return whole.error_xyt


def fold(angle):
    return math.atan2(math.sin(angle), math.cos(angle))


def textbook_sigmas(law, k, rot1, trans, rot2):
    """Standard deviations of rot1, trans, rot2, written out from the article, the lecture and design notes."""
    r1, d, r2 = abs(rot1), abs(trans), abs(rot2)
    if law == "article-code":
        return tuple(sigma * sigma for sigma in textbook_sigmas("linear", k, rot1, trans, rot2))
    if law == "linear":
        return (
            k.rot_rot * r1 + k.rot_trans * d,
            k.trans_trans * d + k.trans_rot * (r1 + r2),
            k.rot_rot * r2 + k.rot_trans * d,
        )
    if law == "quadratic":
        return (
            math.sqrt(k.rot_rot * r1**2 + k.rot_trans * d**2),
            math.sqrt(k.trans_trans * d**2 + k.trans_rot * (r1**2 + r2**2)),
            math.sqrt(k.rot_rot * r2**2 + k.rot_trans * d**2),
        )
    turn = r1 + r2
    if law == "velocity":
        return (
            math.sqrt(k.rot_trans * d**2 + k.rot_rot * turn**2),
            math.sqrt(k.trans_trans * d**2 + k.trans_rot * turn**2),
            math.sqrt(k.end_trans * d**2 + k.end_rot * turn**2),
        )
    if law == "omni":
        return (
            0.0,
            math.sqrt(k.trans_trans * d**2 + k.trans_rot * turn**2),
            math.sqrt(k.rot_rot * turn**2 + k.rot_trans * d**2),
        )
    heading = math.sqrt((k.rot_rot**2 * (r1 + r2) + k.rot_trans**2 * d) / 2)
    return heading, math.sqrt(k.trans_trans**2 * d + k.trans_rot**2 * (r1 + r2)), heading


def textbook_split(ds, dl, dtheta):
    """One increment as rot1, trans, rot2, with reversing and short steps."""
    trans = math.hypot(ds, dl)
    if trans < 0.05:
        return dtheta / 2, math.copysign(trans, ds), dtheta / 2
    rot1 = fold(math.atan2(dl, ds) + dtheta / 2)
    if abs(rot1) > math.pi / 2:
        rot1, trans = fold(rot1 + math.pi), -trans
    return rot1, trans, fold(dtheta - rot1)


def velocity_step(k, pose, moved, rng):
    """Table 5.3 of Probabilistic Robotics over half a second, with the arcs written out."""
    (x, y, theta), (dx, dy, t0, dtheta), dt = pose, moved, 0.5
    chord = math.cos(t0 + dtheta / 2) * dx + math.sin(t0 + dtheta / 2) * dy
    omega = dtheta / dt
    v = chord / dt if abs(dtheta) < 1e-9 else chord / dt * (dtheta / 2) / math.sin(dtheta / 2)
    n1, n2, n3 = rng.standard_normal(3)
    v_hat = v + n1 * math.sqrt(k.trans_trans * v**2 + k.trans_rot * omega**2)
    w_hat = omega + n2 * math.sqrt(k.rot_trans * v**2 + k.rot_rot * omega**2)
    gamma = n3 * math.sqrt(k.end_trans * v**2 + k.end_rot * omega**2)
    if abs(w_hat) < 1e-9:
        x, y = x + v_hat * dt * math.cos(theta), y + v_hat * dt * math.sin(theta)
    else:
        r = v_hat / w_hat
        x += -r * math.sin(theta) + r * math.sin(theta + w_hat * dt)
        y += r * math.cos(theta) - r * math.cos(theta + w_hat * dt)
    return x, y, theta + (w_hat + gamma) * dt


def omni_step(k, pose, moved, rng):
    """One update of amcl's omni-corrected model."""
    (x, y, theta), (dx, dy, t0, dtheta) = pose, moved
    trans, bearing = math.hypot(dx, dy), fold(math.atan2(dy, dx) - t0) + theta
    n1, n2, n3 = rng.standard_normal(3)
    trans_hat = trans + n1 * math.sqrt(k.trans_trans * trans**2 + k.trans_rot * dtheta**2)
    rot_hat = dtheta + n2 * math.sqrt(k.rot_rot * dtheta**2 + k.rot_trans * trans**2)
    strafe_hat = n3 * math.sqrt(k.trans_rot * dtheta**2 + k.across_trans * trans**2)
    x += trans_hat * math.cos(bearing) + strafe_hat * math.sin(bearing)
    y += trans_hat * math.sin(bearing) - strafe_hat * math.cos(bearing)
    return x, y, theta + rot_hat


def textbook_run(law, k, poses, rng):
    """One noisy path, a Python loop over poses: turn, drive, turn, each with its own normal draw."""
    x, y, theta = poses[0]
    path = [(x, y, theta)]
    for (x0, y0, t0), (x1, y1, t1) in pairwise(poses):
        dtheta = fold(t1 - t0)
        if law in {"velocity", "omni"}:
            step = velocity_step if law == "velocity" else omni_step
            x, y, theta = step(k, (x, y, theta), (x1 - x0, y1 - y0, t0, dtheta), rng)
            path.append((x, y, theta))
            continue
        c, s = math.cos(t0 + dtheta / 2), math.sin(t0 + dtheta / 2)
        ds, dl = c * (x1 - x0) + s * (y1 - y0), -s * (x1 - x0) + c * (y1 - y0)
        if law == "diffusion":
            sigmas = textbook_sigmas(law, k, dtheta / 2, math.hypot(ds, dl), dtheta / 2)
        else:
            sigmas = textbook_sigmas(law, k, *textbook_split(ds, dl, dtheta))
        e1, et, e2 = (sigma * draw for sigma, draw in zip(sigmas, rng.standard_normal(3), strict=True))
        theta += e1 + dtheta / 2
        x += math.cos(theta) * (ds + et) - math.sin(theta) * dl
        y += math.sin(theta) * (ds + et) + math.cos(theta) * dl
        theta += dtheta / 2 + e2
        path.append((x, y, theta))
    return np.array(path)
