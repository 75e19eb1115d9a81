"""What these data cannot separate is one sentence, with the drive that settles most of it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from odomcorrupt.report.text.design import inseparable_sentence
from odomcorrupt.study.design.advise import Advice, Ambiguity

BACK = SimpleNamespace(manoeuvre=SimpleNamespace(sentence="straights"), duration_s=180.0)
TWINS = {"wheelbase": ("gyro_scale",)}


def said(*choices, best=BACK):
    return inseparable_sentence(Advice(choices, (), (), best), lambda name: TWINS.get(name, ()))


def choice(*names, plan=BACK):
    return Ambiguity(names, "", plan, 100.0)


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        ((), ""),
        # two names of one error: nothing is open between them
        ((choice("wheelbase", "gyro_scale", plan=None),), ""),
        (
            (choice("gyro_bias", "unequal_wheels"),),
            "These data cannot separate gyro_bias from unequal_wheels: drive straights",
        ),
        (
            (choice("side_slip", "mount_yaw"), choice("side_slip", "icr_shift"), choice("a", "b")),
            "These data cannot separate side_slip from mount_yaw or icr_shift, nor a from b: drive straights",
        ),
        (
            (choice("lever_arm", "icr_shift", plan=None),),
            "These data cannot separate lever_arm from icr_shift; no drive of ten minutes would",
        ),
    ],
)
def test_one_sentence_names_every_pair_once_and_the_drive(choices, sentence):
    assert said(*choices).removesuffix(", for 3 minutes") == sentence
    assert said(*choices).endswith(", for 3 minutes") == ("drive straight" in sentence)
