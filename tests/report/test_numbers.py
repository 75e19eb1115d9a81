"""Numbers of random effects have the unit that their channel gives them."""

from __future__ import annotations

import pytest

from odomcorrupt.effects import effect_from_values
from odomcorrupt.report.text.numbers import noise_text


@pytest.mark.parametrize(("channel", "said"), [("along", "sigma 4 %"), ("wheels", "sigma 2.292 deg/m")])
def test_a_difference_of_the_wheels_gains_is_a_turn_for_each_metre(channel, said):
    effect = effect_from_values("gauss_markov", {"sigma": 0.04, "tau": 5.0, "channel": channel})
    assert noise_text(effect) == [said, "tau 5 s"]
