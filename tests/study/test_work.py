"""Progress of a study whose number of steps is not known in advance."""

from itertools import pairwise

import pytest

from odomcorrupt.study.work import Work


@pytest.mark.parametrize("steps", [1, 2, 6, 40])
def test_the_share_done_never_falls_and_stays_below_one_however_long_the_search(steps):
    said = []
    work = Work(lambda stage, share: said.append((stage, share)), following=2.0)
    work.begin_clocks()
    for _ in range(steps):
        work.begin_step()
        work.within_step("refits")
    work.begin("comparison", 2.0, 0.0)
    shares = [share for _, share in said]
    assert shares[0] == 0.0
    assert len(set(shares)) > steps
    assert all(0.0 <= later - before < 0.5 for before, later in pairwise(shares))
    assert said[-1] == ("comparison", pytest.approx((1.0 + steps) / (3.0 + steps)))
    assert said[-2][0] == f"search, step {steps}: refits"
