"""Thresholds in docs/study.md are those of the code."""

from pathlib import Path

import pytest

from odomcorrupt.study.design.drives import ENOUGH_NATS
from odomcorrupt.study.design.identifiability import FOUND
from odomcorrupt.study.design.manoeuvres import MANOEUVRES
from odomcorrupt.study.estimate import config
from odomcorrupt.study.select.contribution import FAR_M
from odomcorrupt.study.select.decisions import DECISIONS as D
from odomcorrupt.study.validate import round_trip
from odomcorrupt.study.validate.evaluation import BLOCK_S
from odomcorrupt.study.validate.goodness_of_fit import PRACTICAL_FACTOR

TEXT = " ".join((Path(__file__).parents[2] / "docs" / "study.md").read_text(encoding="utf8").split())
WORDS = {2: "two", 13: "thirteen"}


@pytest.mark.parametrize(
    "phrase",
    [
        f"**Intervals** are {config.INTERVAL_S:g} s long; {config._COARSE_INTERVAL_S:g} s if the truth",
        f"noisier than {config._COARSE_TRUTH_M * 1e3:g} mm; {config._BLIND_INTERVAL_S:g} s for positions only",
        f"each of every tenth segment of {BLOCK_S:g} s", f"A term costs {D.term_nats:g} nats,",
        f"plus {D.rare_nats:g} nats if it is none of",
        f"cost {D.commanded_nats:g} nats more, each word that is not the usual one {D.unusual_shape_nats:g} nats",
        f"a basis function {D.basis_nats:g} nats. A clock costs {D.clock_nats:g} nats",
        f"off by more than {1e3 * D.far_clock_s:g} ms", f"at least {D.clear_errors:g} standard errors over folds",
        f"evidence is at most {D.rival_nats:g} nats smaller",
        f"gains {D.correlated_nats:g} nats after its penalty beside", f"has to gain {D.mean_reverting_nats:g} nats",
        f"at most {WORDS[D.max_dependences]} in all",
        f"10 s error would grow by less than {100 * D.practical.share:g} %",
        f"error over {FAR_M:g} m of path by less than {100 * D.practical.far_share:g} %",
        f"or it moves less than {1e3 * D.practical.per_m:g} mm per metre",
        f"are {PRACTICAL_FACTOR:g} times larger or smaller than predicted",
        f"({round_trip.RUNS} runs if it has random effects", f"{WORDS[len(MANOEUVRES)]} manoeuvres",
        f"would give less than {ENOUGH_NATS:g} nats", f"Detection limits are {FOUND:g} standard errors",
    ],
)  # fmt: skip
def test_the_page_states_the_thresholds_of_the_code(phrase):
    assert phrase in TEXT
