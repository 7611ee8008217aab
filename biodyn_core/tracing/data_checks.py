"""Data checks before any candidate is fitted.

They decide which sensors and events are used, and whether there is enough data for a verdict.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.segments import MEASURED_SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.base.wording import counted
from biodyn_core.body.model import Chain, predict
from biodyn_core.body.subject import Subject
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.findings import Need
from biodyn_core.tracing.settings import FloorSettings


@dataclass(frozen=True)
class Contents:
    """Contents of events: seconds without shocks, number of shocks, and number of hard ones among them."""

    road_s: float
    shocks: int
    hard_shocks: int


def seat_tension(subject: Subject, case: Case) -> float:
    """The largest tension of the seat's joint in a prediction, over the weight above it.

    A seat carries no tension: above 1 the body must lift off, which is a known omission of the base chain. 0 for a
    subject with that effect.
    """
    if any(applied.effect.known_omission for applied in subject.effects):
        return 0.0
    chain = Chain.of(subject)
    response = predict(subject, case.seat_mps2, case.rate_hz, case.channels)
    stretch, rate = response.displacement_m[:, 0], response.velocity_mps[:, 0]
    stiffness = chain.stiffness_n_per_m[0] * (1.0 + chain.stiffening_per_m[0] * np.abs(stretch))
    tension_n = stiffness * stretch + chain.damping_n_s_per_m[0] * rate
    return float(tension_n.max() / (STANDARD_GRAVITY_MPS2 * chain.loaded_mass_kg(subject.effects).sum()))


def contents(cases: Sequence[Case], settings: FloorSettings | None = None) -> Contents:
    """Count the contents of events after their warm-up."""
    s = settings or FloorSettings()
    road_s, shocks, hard = 0.0, 0, 0
    for case in cases:
        peaks = _peaks_g(case, s)
        shocks, hard = shocks + peaks.size, hard + int(np.count_nonzero(peaks >= s.hard_shock_g))
        seconds = (case.seat_mps2.size - case.begin) / case.rate_hz
        road_s += max(0.0, seconds - s.apart_s * peaks.size)
    return Contents(road_s, shocks, hard)


def missing(cases: Sequence[Case], role: str, settings: FloorSettings | None = None) -> list[str]:
    """The missing data for a verdict, one line each; role is the use of the events, such as `to fit`."""
    s = settings or FloorSettings()
    return missing_from(contents(cases, s), role, s)


def missing_from(has: Contents, role: str, settings: FloorSettings) -> list[str]:
    """What these contents lack for a verdict, one line each."""
    s = settings
    wanted = (
        (has.road_s, s.road_s, f"{has.road_s:.3g} s without shocks"),
        (has.shocks, s.shocks, f"{counted(has.shocks, 'shock')} of {s.shock_g:g} g and more"),
        (has.hard_shocks, s.hard_shocks, f"{counted(has.hard_shocks, 'shock')} of {s.hard_shock_g:g} g and more"),
    )
    return [
        f"{role}: {text}, {least:g} {'is' if least == 1 else 'are'} needed"
        for found, least, text in wanted
        if found < least
    ]


def lacking(train: Sequence[Case], held_out: Sequence[Case], settings: FloorSettings | None = None) -> list[str]:
    """Why these events have too little data for a verdict, a line each."""
    found = missing(train, "to fit", settings) + missing(held_out, "held out", settings)
    if train and len({case.case for case in train}) < 2:
        found.append(f"to fit: only {train[0].case}; two loading conditions are needed")
    choose, report = split_held_out(held_out)
    if not choose or not report:
        found.append("held out: two events of one loading condition are needed, one to choose by and one to report")
    found += [f"held out: {one.name} is also fitted to" for one in _in_both(train, held_out)]
    return found


def needs(train: Sequence[Case], held_out: Sequence[Case], settings: FloorSettings | None = None) -> list[Need]:
    """The recordings that are missing for a verdict, at most one need for each use."""
    twice = _in_both(train, held_out)
    spare = [one for one in held_out if not any(one is other for other in twice)]
    to_fit, held = _need("to fit", train, settings), _need("held out", spare, settings)
    conditions = list(dict.fromkeys(case.case for case in train))
    if len(conditions) < 2:
        condition = f"another loading condition than {conditions[0]}" if conditions else "two loading conditions"
        to_fit = dataclasses.replace(to_fit, conditions=(condition,))
    needed = [f"another recording than {one.name}, which is also fitted to" for one in twice]
    if not all(split_held_out(spare)):
        there = " or ".join(dict.fromkeys(case.case for case in spare))
        needed.append(f"a further recording of {there}" if there else "two recordings of one loading condition")
    held = dataclasses.replace(held, conditions=tuple(needed))
    return [one for one in (to_fit, held) if one.road_s or one.shocks or one.conditions]


def split_held_out(held_out: Sequence[Case]) -> tuple[list[Case], list[Case]]:
    """Events for choosing and events for reporting, by records alternately for each loading condition."""
    choose: list[Case] = []
    report: list[Case] = []
    of_condition: dict[str, dict[str, list[Case]]] = {}
    for case in held_out:
        records = of_condition.setdefault(case.case, {})
        use = records.setdefault(case.record or case.name, report if len(records) % 2 else choose)
        use.append(case)
    return choose, report


def usable(
    train: Sequence[Case], held_out: Sequence[Case], settings: FloorSettings | None = None
) -> tuple[list[Case], list[Case], list[str]]:
    """The events without sensors that clipped or failed in them, and a line for each of these.

    A channel that a held-out event lacks is left out of all events: no effect is added whose error cannot be reported.
    """
    left_out: list[str] = []
    kept: tuple[list[Case], list[Case]] = ([], [])
    for side, cases in zip(kept, (train, held_out), strict=True):
        for case in cases:
            found, lines = without_failed_sensors(case, settings)
            left_out += lines
            if found.energy.any():
                side.append(found)
    for_all = [set(case.channels) for case in kept[1]]
    shared = set.intersection(*for_all) if for_all else None
    to_fit, to_hold_out = ([_with_channels(case, shared) for case in side] for side in kept)
    return to_fit, to_hold_out, left_out


def _with_channels(case: Case, shared: set[str] | None) -> Case:
    """The case without channels beyond the shared ones; None for no limit."""
    if shared is None or set(case.channels) <= shared:
        return case
    return dataclasses.replace(case, channels={name: of for name, of in case.channels.items() if name in shared})


def _need(use: Literal["to fit", "held out"], cases: Sequence[Case], settings: FloorSettings | None) -> Need:
    """The difference of these events to the floor; every hard shock counts as a shock too."""
    s = settings or FloorSettings()
    found = contents(cases, s)
    hard = max(0, s.hard_shocks - found.hard_shocks)
    return Need(use, max(0.0, s.road_s - found.road_s), max(s.shocks - found.shocks, hard), hard)


def _in_both(train: Sequence[Case], held_out: Sequence[Case]) -> list[Case]:
    return [one for one in held_out if any(same_motion(one, other) for other in train)]


def _peaks_g(case: Case, s: FloorSettings) -> Floats:
    """The largest reading of every shock of a case, in g, after the warm-up."""
    size = np.abs(case.seat_mps2[case.begin :]) / STANDARD_GRAVITY_MPS2
    above = np.flatnonzero(size >= s.shock_g)
    if above.size == 0:
        return np.empty(0)
    parts = np.split(above, np.flatnonzero(np.diff(above) > s.apart_s * case.rate_hz) + 1)
    return np.array([size[part].max() for part in parts])


def without_failed_sensors(case: Case, settings: FloorSettings | None = None) -> tuple[Case, list[str]]:
    """A case without the sensors with too many masked samples, and a line for each; clipping also shifts the level."""
    s = settings or FloorSettings()
    share = case.compared[case.begin :].mean(axis=0)
    bad = (case.energy > 0.0) & (share < share.max() - s.masked_share)
    lines = [
        f"{case.name}: {name}, {100.0 * (share.max() - share[i]):.0f} % clipped, stuck or missing"
        for i, name in enumerate(MEASURED_SEGMENTS)
        if bad[i]
    ]
    if not lines:
        return case, lines
    compared = case.compared & ~bad
    energy = np.where(bad, 0.0, case.energy)
    return dataclasses.replace(case, compared=compared, energy=energy), lines


def same_motion(one: Case, other: Case) -> bool:
    """Whether two cases have the same seat motion, sample by sample."""
    a, b = one.seat_mps2, other.seat_mps2
    return a.size == b.size and bool(np.array_equal(a, b))
