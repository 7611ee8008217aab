"""The usual residual of a fit: windows of the events that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body.subject import Subject
from biodyn_core.body.usual_residual import UsualResidual
from biodyn_core.identification.fit import predictions
from biodyn_core.identification.problem import Case


def usual_residual(subject: Subject, held_out: Sequence[Case]) -> dict[str, UsualResidual]:
    """The usual residual by segment, for those with enough compared seconds in the held-out cases."""
    columns: list[tuple[list[Floats], list[Floats]]] = [([], []) for _ in MEASURED_SEGMENTS]
    for case, predicted in zip(held_out, predictions(subject, held_out), strict=True):
        length = round(case.rate_hz)
        count = len(predicted) // length
        whole = slice(0, count * length)
        compared = np.asarray(case.compared[whole].reshape(count, length, -1).all(axis=1))
        residual = _mean_squares(predicted[whole] - case.measured_mps2[whole], count)
        motion = _mean_squares(predicted[whole], count)
        for column, (residuals, motions) in enumerate(columns):
            residuals.append(residual[compared[:, column], column])
            motions.append(motion[compared[:, column], column])
    found = {}
    for name, (residuals, motions) in zip(MEASURED_SEGMENTS, columns, strict=True):
        law = UsualResidual.of_windows(np.concatenate(residuals), np.concatenate(motions)) if residuals else None
        if law is not None:
            found[name] = law
    return found


def _mean_squares(values: Floats, count: int) -> Floats:
    """Mean squares (count, c) of so many windows of equal length in (n, c)."""
    return np.asarray(np.mean(values.reshape(count, -1, values.shape[1]) ** 2, axis=1)) if count else values[:0]
