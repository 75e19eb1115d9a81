"""A truth of positions without headings: its headings are NaN."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError

if TYPE_CHECKING:
    from odomcorrupt.study.trajectory import Recording

__all__ = ["need_headings"]


def need_headings(recording: Recording) -> None:
    """Refuse a truth without headings, for what cannot do without.

    Raises
    ------
    RecordingError
        Where the truth holds positions alone.

    """
    if np.isnan(recording.truth.xyt[:, 2]).all():
        raise RecordingError(
            f"{recording.name}: the truth has positions without headings, which cannot be used here yet; give a truth "
            "with headings"
        )
