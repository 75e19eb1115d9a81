"""An expression that is offered for an unknown dependence can be added as it is, and then the error falls."""

from __future__ import annotations

import pytest
from hidden import as_recording, ten_second_error

from odomcorrupt.effects.user import user_effect
from odomcorrupt.simulate import simulate, simulate_without
from odomcorrupt.study.fitting.approach import choose_approach
from odomcorrupt.study.fitting.gauss_newton import fit
from odomcorrupt.study.search.learn import learn


def test_an_expression_of_numbers_alone_is_held_while_everything_else_is_fitted():
    run = as_recording(simulate(70, None, duration_s=120.0))
    fixed = user_effect("bend", "yaw += 0.01 * v", {})
    fitted = fit([run], [fixed], approach=choose_approach([run]))
    assert fitted.effects == (fixed,)
    assert len(fitted.standard_errors) == 0


@pytest.mark.slow
def test_the_law_of_a_cause_that_no_library_has_brings_the_error_down():
    options = {"parameters": {"k": 0.05}, "robot_seed": 71}
    run = as_recording(simulate(71, "turn_scrub", **options))
    learned = learn([run])
    unknown = learned.unknown[0]
    assert (unknown.driver, unknown.channel) == ("yaw_rate", "yaw")
    offered = user_effect("offered", unknown.expression, {})
    # what was found beside it was found without it: fitted again, as `fit` does with the expression in a model file
    again = fit([run], (*learned.fit.effects, offered), approach=learned.fit.problem.approach)
    judged = as_recording(simulate(72, "turn_scrub", duration_s=300.0, **options))
    floor = as_recording(simulate_without(72, "turn_scrub", duration_s=300.0, **options))
    assert ten_second_error([judged], again.effects) < 1.25 * ten_second_error([floor])
    assert ten_second_error([judged]) > 1.5 * ten_second_error([floor])
