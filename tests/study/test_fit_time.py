"""The time of a fit is proportional to the drive: a long one is read no more often than a short one."""

from hidden import as_recording

from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate import gauss_newton, problem
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.estimate.noise_likelihood import NoiseLikelihood


def looks(monkeypatch, duration_s):
    """Return how often a base fit evaluates a likelihood, and how often it lays the drive out anew."""
    counted = {"evaluated": 0, "posed": 0}
    evaluate, pose = NoiseLikelihood.evaluate, gauss_newton.pose_problem

    def evaluating(self, free):
        counted["evaluated"] += 1
        return evaluate(self, free)

    def posing(*given, **named):
        counted["posed"] += 1
        return pose(*given, **named)

    with monkeypatch.context() as patch:
        patch.setattr(NoiseLikelihood, "evaluate", evaluating)
        for module in (gauss_newton, problem):
            patch.setattr(module, "pose_problem", posing)
        fit_robot([as_recording(simulate(1, "unequal_wheels", duration_s=duration_s))], [], law_name="diffusion")
    return counted["evaluated"], counted["posed"]


def test_a_long_drive_is_read_no_more_often_than_a_short_one(monkeypatch):
    short, long = looks(monkeypatch, 120.0), looks(monkeypatch, 600.0)
    # 420 evaluations and eleven layouts were needed once, and 90 000 steps took three times as long
    assert max(short[0], long[0]) < 330
    assert max(short[1], long[1]) < 12
    assert long[0] < 2.0 * short[0]
