"""Unsteady causes, which no constant parameters describe: clocks that jump, spectral lines that vary, posture changes.

They give the kind of cause and its site. A subject can store only their constant part.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS, N_SEGMENTS, SEGMENTS
from biodyn_core.effects import CATALOGUE, AppliedEffect, Effect
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.local_fit import LocalFit
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.settings import UnsteadySettings


@dataclass(frozen=True, eq=False)
class UnsteadyCause:
    """A cause that is fitted again in every window or event; residual_square (w,): by window for choosing."""

    applied: AppliedEffect
    residual_square: Floats
    objection: str = ""


def unsteady_causes(nuisance: NuisanceModel, without: LocalFit, settings: UnsteadySettings) -> Iterator[UnsteadyCause]:
    """Causes without constant parameters, with their objections."""
    events, b = nuisance.choose, without.coefficients
    residuals = [y - known @ b for known, y in zip(events.known, events.residuals(without.subject), strict=True)]
    for effect in CATALOGUE.values():
        if effect.varies_as == "delay":
            yield from _delays(effect, nuisance, residuals, settings)
        elif effect.varies_as == "line":
            yield from _lines(effect, nuisance, without, residuals, settings)
        elif effect.varies_as == "step":
            yield from _steps(effect, nuisance, without, residuals)


def _delays(
    effect: Effect, nuisance: NuisanceModel, residuals: Sequence[Floats], s: UnsteadySettings
) -> Iterator[UnsteadyCause]:
    """The delay of each sensor, fitted in every window, if it is atypical."""
    rows = nuisance.choose.rows
    for site in effect.sites:
        segment = MEASURED_SEGMENTS.index(site)
        pairs = [one.clock_corrected(y, segment) for one, y in zip(rows, residuals, strict=True)]
        late_s = np.concatenate([late for _, late in pairs])
        late_s = late_s[late_s != 0.0]  # a window without compared samples has no delay
        if late_s.size == 0 or np.median(np.abs(late_s)) <= rows[0].typical_clock_s:
            continue
        delay_s = float(np.clip(np.median(late_s), -s.most_late_s, s.most_late_s))
        squares = [(residual**2).sum(axis=1) for residual, _ in pairs]
        yield UnsteadyCause(effect.sized(site, delay_s), np.concatenate(squares))


def _lines(
    effect: Effect, nuisance: NuisanceModel, without: LocalFit, residuals: Sequence[Floats], s: UnsteadySettings
) -> Iterator[UnsteadyCause]:
    """The most prominent line of the residual, on each segment, fitted in parts of windows."""
    events = nuisance.choose
    frequency_hz = _line_hz(nuisance, residuals, s)
    if frequency_hz is None:
        return
    moving = np.concatenate([rows.moving_mps2(s.parts) for rows in events.rows])
    for site in effect.sites:
        both = [effect.sized(site, *amplitudes_mps2, frequency_hz) for amplitudes_mps2 in ((1.0, 0.0), (0.0, 1.0))]
        squares, sizes = [], []
        for case, rows, y in zip(events.cases, events.rows, residuals, strict=True):
            plain = answer(without.subject, case)
            shown = np.stack([answer(without.subject, case, (line,), plain) - plain for line in both], axis=2)
            square, size = _fitted_in_parts(y, rows(shown), s.parts)
            squares.append(square)
            sizes.append(size)
        size = np.concatenate(sizes)
        applied = effect.sized(site, max(float(np.median(size)), s.least_line_mps2), 0.0, frequency_hz)
        yield UnsteadyCause(applied, np.concatenate(squares), _objection(_growth(size, moving), s))


def _growth(size: Floats, moving: Floats) -> float:
    """Ratio of the median size (p,) in the quarter of parts with most motion to that in the quarter with least."""
    order, quarter = np.argsort(moving, kind="stable"), max(1, moving.size // 4)
    least, most = (float(np.median(size[some])) for some in (order[:quarter], order[-quarter:]))
    return most / least if least > 0.0 else 1.0


def _objection(growth: float, s: UnsteadySettings) -> str:
    if growth <= s.most_growth:
        return ""
    return f"its line grows {growth:.1f} times with the motion, so it is a response of the body and no periodic force"


def _fitted_in_parts(residual: Floats, columns: Floats, parts: int) -> tuple[Floats, Floats]:
    """Squared residual (w,) with columns (w, r, 2) fitted in each part of each window, and the sizes (w * parts,)."""
    windows, each = len(residual), residual.shape[1] // parts * parts
    y = residual[:, :each].reshape(windows * parts, -1)
    c = columns[:, :each].reshape(windows * parts, -1, columns.shape[2])
    normal = np.einsum("pri,prj->pij", c, c)
    ridge = 1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12
    found = np.linalg.solve(normal + ridge * np.eye(c.shape[2]), np.einsum("pri,pr->pi", c, y)[:, :, None])
    square = ((y - (c @ found)[:, :, 0]) ** 2).reshape(windows, -1).sum(axis=1) + (residual[:, each:] ** 2).sum(axis=1)
    return square, np.linalg.norm(found[:, :, 0], axis=1)


def _line_hz(nuisance: NuisanceModel, residuals: Sequence[Floats], s: UnsteadySettings) -> float | None:
    """The frequency of the most prominent line of the residual, None if there is none; short events are left out."""
    frequency_hz = np.arange(0.0, s.line_hz[1] + s.around_hz, 1.0 / s.segment_s)
    total = np.zeros(frequency_hz.size)
    for rows, y in zip(nuisance.choose.rows, residuals, strict=True):
        whole, each = y.reshape(-1, len(MEASURED_SEGMENTS)), round(s.segment_s * rows.rate_hz)
        if len(whole) >= each:
            own_hz, density = scipy.signal.welch(whole, rows.rate_hz, nperseg=each, axis=0)
            total += np.interp(frequency_hz, own_hz, density.sum(axis=1))
    around = scipy.ndimage.median_filter(total, round(2.0 * s.around_hz * s.segment_s) + 1)
    inside = (frequency_hz >= s.line_hz[0]) & (frequency_hz <= s.line_hz[1])
    prominence = np.where(inside, total / np.maximum(around, 1e-30), 0.0)
    best = int(prominence.argmax())
    return float(frequency_hz[best]) if prominence[best] > s.prominence else None


def _steps(
    effect: Effect, nuisance: NuisanceModel, without: LocalFit, residuals: Sequence[Floats]
) -> Iterator[UnsteadyCause]:
    """Each joint with different stiffness and damping before and after an instant between two events.

    Fitted to the events for fitting alone, so the events for choosing do not influence it.
    """
    train, choose, b = nuisance.train, nuisance.choose, without.coefficients
    fitted = [y - known @ b for known, y in zip(train.known, train.residuals(without.subject), strict=True)]
    begins_ns = np.array([case.begins_ns for case in train.cases])
    weights = [nuisance.weight[train.products.event == e][0] for e in range(len(train.cases))]
    for site in effect.sites:
        joint = SEGMENTS.index(site)
        own = [joint, N_SEGMENTS + joint]
        normal = np.array(
            [
                w * np.einsum("wri,wrj->ij", k[:, :, own], k[:, :, own])
                for w, k in zip(weights, train.known, strict=True)
            ]
        )
        match = np.array(
            [w * np.einsum("wri,wr->i", k[:, :, own], y) for w, k, y in zip(weights, train.known, fitted, strict=True)]
        )
        found = [_step_change(normal, match, begins_ns >= at_ns) for at_ns in np.unique(begins_ns)[1:]]
        if not found:
            return
        number = int(np.argmax([decrease for decrease, _, _ in found]))
        (last_ns, first_ns), (_, before, after) = np.unique(begins_ns)[number : number + 2], found[number]
        # Events between both instants have the unchanged joint, because the instant of the change is unknown.
        changes = [(case.begins_ns <= last_ns) * before + (case.begins_ns >= first_ns) * after for case in choose.cases]
        squares = [
            ((y - known[:, :, own] @ change) ** 2).sum(axis=1)
            for change, known, y in zip(changes, choose.known, residuals, strict=True)
        ]
        change_of_stiffness = float(np.exp(2.0 * (after - before)[0]) - 1.0)
        yield UnsteadyCause(effect.sized(site, change_of_stiffness), np.concatenate(squares))


def _step_change(normal: Floats, match: Floats, is_after: Flags) -> tuple[float, Floats, Floats]:
    """Decrease of the squares by one change of the columns before and another after the instant, and both changes."""
    ridge = 1e-9 * np.trace(normal.sum(axis=0)) * np.eye(normal.shape[1])
    before, after = (
        np.linalg.solve(normal[w].sum(axis=0) + ridge, match[w].sum(axis=0)) for w in (~is_after, is_after)
    )
    return float(before @ match[~is_after].sum(axis=0) + after @ match[is_after].sum(axis=0)), before, after
