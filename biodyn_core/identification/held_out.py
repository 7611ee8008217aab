"""The usual residual of a fit: windows of the events that it was not fitted to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.subject import Subject
from biodyn_core.body.usual_residual import UsualResidual
from biodyn_core.identification.fit import predictions
from biodyn_core.identification.problem import Case
from biodyn_core.signals.octaves import octave_squares


def usual_residual(subject: Subject, held_out: Sequence[Case]) -> dict[str, UsualResidual]:
    """The usual residual by segment, for those with enough compared seconds in the held-out cases.

    Seconds in which the model diverges do not count: a prediction that is not finite has no residual.
    """
    windows = [
        one
        for case, predicted in zip(held_out, predictions(subject, held_out), strict=True)
        for one in _windows(case, predicted)
    ]
    if not windows:
        return {}
    usable, residual, motion = (np.array(column) for column in zip(*windows, strict=True))
    found = {}
    for column, name in enumerate(MEASURED_SEGMENTS):
        use = usable[:, column]
        law = UsualResidual.of_windows(residual[use, :, column], motion[use, :, column])
        if law is not None:
            found[name] = law
    return found


def _windows(case: Case, predicted: Floats) -> Iterator[tuple[Flags, Floats, Floats]]:
    """Which segments can be used (5,), and mean squares (6, 5) of residual and prediction, second by second.

    A segment can be used in a second in which all its samples are compared and both squares are finite.
    """
    length = round(case.rate_hz)
    for begin in range(case.begin, len(predicted) - length + 1, length):
        part = slice(begin, begin + length)
        with np.errstate(all="ignore"):  # squares of a model that diverges
            residual = octave_squares(predicted[part] - case.measured_mps2[part], case.rate_hz)
            motion = octave_squares(predicted[part], case.rate_hz)
        finite = np.isfinite(residual).all(axis=0) & np.isfinite(motion).all(axis=0)
        yield np.asarray(case.compared[part].all(axis=0) & finite), residual, motion
