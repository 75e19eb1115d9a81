"""Scales are bounded alike whether odometry says too much or too little."""

from __future__ import annotations

import pytest

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import parameters


@pytest.mark.parametrize("name", ["wheel_scale", "sideways_scale", "wheelbase", "gyro_scale", "steering_scale"])
def test_a_ratio_and_its_inverse_are_both_possible(name):
    (scale,) = (p for p in parameters(registry()[name]) if p.name == "e")
    assert (1.0 + scale.low) * (1.0 + scale.high) == pytest.approx(1.0)
