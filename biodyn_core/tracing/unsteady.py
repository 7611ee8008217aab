"""Unsteady: what no fixed parameters follow: clocks that jump, lines that wander, postures that change meanwhile.

What is told by this is which cause it is and where; a subject can carry only its steady share.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage, signal

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS, N_SEGMENTS, SEGMENTS
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.local_fit import LocalFit
from biodyn_core.tracing.nuisance_model import Background

LATEST_S: Final = 0.02
"""A clock that seems off by more is another's fault."""

LINE_HZ: Final = (10.0, 80.0)
AROUND_HZ: Final = 10.0
PROMINENT: Final = 3.0
"""A line stands out of the spectrum around it by so many times."""

SEGMENT_S: Final = 1.0
"""Over which its spectrum is taken: a resolution of 1 Hz."""

PARTS: Final = 4
"""Of a window: amplitude and phase of a line are set in each."""

GROWS: Final = 3.0
"""An engine shakes at standstill as it does in a shock. In bodies that something periodic shakes, lines were 0.8 to 1.9
times as large in the quarter of the parts that moves most as in that which moves least; 4.8 times and more where a
muscle trembles with its load, or a joint lacks what answers to the seat."""


@dataclass(frozen=True, eq=False)
class SetAnew:
    """A cause that is set anew time and again, and what it leaves in each window that chooses, squares (w,)."""

    applied: AppliedEffect
    left: Floats
    against: str = ""


def unsteady(background: Background, without: LocalFit) -> Iterator[SetAnew]:
    """Causes that no fixed parameters follow, with what speaks against them."""
    side = background.choose
    missed = [y - known @ without.departures for known, y in zip(side.known, side.missed(without.subject), strict=True)]
    yield from _clocks(background, missed)
    yield from _lines(background, without, missed)
    yield from _postures(background, without, missed)


def _clocks(background: Background, missed: Sequence[Floats]) -> Iterator[SetAnew]:
    """Each sensor's clock, set anew in every window; one that is off by no more than is usual is left out."""
    for segment, name in enumerate(MEASURED_SEGMENTS):
        pairs = [rows.on_time(y, segment) for rows, y in zip(background.choose.rows, missed, strict=True)]
        late_s = np.concatenate([late for _, late in pairs])
        late_s = late_s[late_s != 0.0]  # a window in which nothing is compared tells nothing
        if late_s.size == 0 or np.median(np.abs(late_s)) <= background.choose.rows[0].usual_clock_s:
            continue
        delay_s = float(np.clip(np.median(late_s), -LATEST_S, LATEST_S))
        applied = AppliedEffect(CATALOGUE["clock"], name, {"delay_s": delay_s, "drift": 0.0})
        yield SetAnew(applied, np.concatenate([(left**2).sum(axis=1) for left, _ in pairs]))


def _lines(background: Background, without: LocalFit, missed: Sequence[Floats]) -> Iterator[SetAnew]:
    """The most prominent line of what is left, on each segment, set anew in parts of windows."""
    side = background.choose
    frequency_hz = _line_hz(background, missed)
    if frequency_hz is None:
        return
    effect = CATALOGUE["periodic"]
    moving = np.concatenate([rows.moving_mps2(PARTS) for rows in side.rows])
    for site in effect.sites:
        one = {"cosine_mps2": 1.0, "sine_mps2": 0.0, "frequency_hz": frequency_hz}
        both = [
            AppliedEffect(effect, site, values)
            for values in (one, one | {"cosine_mps2": 0.0, "sine_mps2": 1.0})
        ]  # fmt: skip
        left, sizes = [], []
        for case, rows, y in zip(side.cases, side.rows, missed, strict=True):
            plain = answer(without.subject, case)
            shown = np.stack([answer(without.subject, case, (line,), plain) - plain for line in both], axis=2)
            gone, size = _set_anew(y, rows(shown))
            left.append(gone)
            sizes.append(size)
        size = np.concatenate(sizes)
        applied = AppliedEffect(effect, site, one | {"cosine_mps2": float(np.clip(np.median(size), 0.01, 2.0))})
        yield SetAnew(applied, np.concatenate(left), _against(_growth(size, moving)))


def _growth(size: Floats, moving: Floats) -> float:
    """How many times larger sizes (p,) are in the quarter of parts that moves most than in that which moves least."""
    order, quarter = np.argsort(moving, kind="stable"), max(1, moving.size // 4)
    least, most = (float(np.median(size[some])) for some in (order[:quarter], order[-quarter:]))
    return most / least if least > 0.0 else 1.0


def _against(growth: float) -> str:
    return (
        f"its line grows {growth:.1f} times with the motion: the body answers, nothing shakes it"
        if growth > GROWS
        else ""
    )


def _set_anew(missed: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """What columns (w, r, 2), fitted to each part of each window by itself, leave, squares (w,), and their sizes."""
    windows, each = len(missed), missed.shape[1] // PARTS * PARTS
    y = missed[:, :each].reshape(windows * PARTS, -1)
    c = columns[:, :each].reshape(windows * PARTS, -1, columns.shape[2])
    normal = np.einsum("pri,prj->pij", c, c)
    ridge = 1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-12
    found = np.linalg.solve(normal + ridge * np.eye(c.shape[2]), np.einsum("pri,pr->pi", c, y)[:, :, None])
    left = ((y - (c @ found)[:, :, 0]) ** 2).reshape(windows, -1).sum(axis=1) + (missed[:, each:] ** 2).sum(axis=1)
    return left, np.linalg.norm(found[:, :, 0], axis=1)


def _line_hz(background: Background, missed: Sequence[Floats]) -> float | None:
    """The frequency that stands out most of what is left, None where none does; short events have no say."""
    frequency_hz = np.arange(0.0, LINE_HZ[1] + AROUND_HZ, 1.0 / SEGMENT_S)
    total = np.zeros(frequency_hz.size)
    for rows, y in zip(background.choose.rows, missed, strict=True):
        whole, each = y.reshape(-1, len(MEASURED_SEGMENTS)), round(SEGMENT_S * rows.rate_hz)
        if len(whole) >= each:
            own_hz, density = signal.welch(whole, rows.rate_hz, nperseg=each, axis=0)
            total += np.interp(frequency_hz, own_hz, density.sum(axis=1))
    around = ndimage.median_filter(total, round(2.0 * AROUND_HZ * SEGMENT_S) + 1)
    inside = (frequency_hz >= LINE_HZ[0]) & (frequency_hz <= LINE_HZ[1])
    stands_out = np.where(inside, total / np.maximum(around, 1e-30), 0.0)
    best = int(stands_out.argmax())
    return float(frequency_hz[best]) if stands_out[best] > PROMINENT else None


def _postures(background: Background, without: LocalFit, missed: Sequence[Floats]) -> Iterator[SetAnew]:
    """Each joint with one stiffness and damping before an instant between two events, and others behind it.

    Found by the events that are fitted to, so that those that choose have had no say.
    """
    train, choose, b = background.train, background.choose, without.departures
    fitted = [y - known @ b for known, y in zip(train.known, train.missed(without.subject), strict=True)]
    begins_ns = np.array([case.begins_ns for case in train.cases])
    weights = [background.weight[train.products.event == e][0] for e in range(len(train.cases))]
    for joint, site in enumerate(SEGMENTS):
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
        found = [_two(normal, match, begins_ns >= at_ns) for at_ns in np.unique(begins_ns)[1:]]
        if not found:
            return
        number = int(np.argmax([gone for gone, _, _ in found]))
        (last_ns, first_ns), (_, before, behind) = np.unique(begins_ns)[number : number + 2], found[number]
        # Whether it had changed by then, nobody knows of events in between.
        sides = [(case.begins_ns <= last_ns) * before + (case.begins_ns >= first_ns) * behind for case in choose.cases]
        left = [
            ((y - known[:, :, own] @ changed) ** 2).sum(axis=1)
            for changed, known, y in zip(sides, choose.known, missed, strict=True)
        ]
        jump = float(np.clip(np.exp(2.0 * (behind - before)[0]) - 1.0, -0.6, 1.0))
        yield SetAnew(AppliedEffect(CATALOGUE["posture"], site, {"jump": jump, "at_s": 0.0}), np.concatenate(left))


def _two(normal: Floats, match: Floats, is_behind: Flags) -> tuple[float, Floats, Floats]:
    """What one change of the columns before and another behind take off the squares, and both."""
    ridge = 1e-9 * np.trace(normal.sum(axis=0)) * np.eye(normal.shape[1])
    before, behind = (
        np.linalg.solve(normal[w].sum(axis=0) + ridge, match[w].sum(axis=0)) for w in (~is_behind, is_behind)
    )
    return float(before @ match[~is_behind].sum(axis=0) + behind @ match[is_behind].sum(axis=0)), before, behind
