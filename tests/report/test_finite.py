"""JSON has no word for what is not a number: it becomes null, wherever it stands."""

from __future__ import annotations

import json

import numpy as np

from odomcorrupt.report.json.numbers import finite


def test_what_is_not_finite_becomes_null_at_any_depth_and_numpy_becomes_plain():
    printed = {
        "log_p": -np.inf,
        "rows": [(1.5, float("nan")), {"size": np.float64("inf"), "count": np.int64(3), "kept": np.bool_(True)}],
        "curve": np.array([[0.5, np.nan], [np.inf, 2.0]]),
        "name": "slip",
        "none": None,
    }
    assert json.loads(json.dumps(finite(printed), allow_nan=False)) == {
        "log_p": None,
        "rows": [[1.5, None], {"size": None, "count": 3, "kept": True}],
        "curve": [[0.5, None], [None, 2.0]],
        "name": "slip",
        "none": None,
    }
