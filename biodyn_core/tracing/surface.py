"""Surface: what force a joint lacks over its stretch and rate, as hat functions inside the chain (tracing, E).

Where nothing of the catalogue passes it says whether a law of this joint is missing at all: if a surface gains nothing
either, what is missing is memory, measurement or input.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import Chain, predict
from biodyn_core.body.subject import Subject
from biodyn_core.effects import AppliedEffect, EffectParameter, Joint, JointForce
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.findings import Surface
from biodyn_core.tracing.local_fit import LocalFit, predicted
from biodyn_core.tracing.nuisance_model import Background
from biodyn_core.tracing.screen import mean_log_ratio

ACROSS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Knots of stretch and of rate, in reaches of the joint; beyond the last a hat stays at its height."""

SHARE: Final = 0.1
"""Usual height of a hat, as a share of the joint's linear force at its reach."""

REACH: Final = 99.0
"""Percentile of stretch and rate that is called the reach."""


def force(
    stretch: float, rate: float, seat: float, height_n: float, stretch_m: float, rate_mps: float, at: float,
    speed: float,
) -> float:  # fmt: skip
    """One hat over stretch and rate, N."""
    u = min(max(stretch / stretch_m, -1.0), 1.0)
    w = min(max(rate / rate_mps, -1.0), 1.0)
    return height_n * max(0.0, 1.0 - 2.0 * abs(u - at)) * max(0.0, 1.0 - abs(w - speed))


def _constants(joint: Joint, values: Mapping[str, float]) -> tuple[float, ...]:
    return tuple(values[name] for name in ("height_n", "stretch_m", "rate_mps", "at", "speed"))


HAT: Final = JointForce(
    name="hat",
    family="surface",
    equation="F += h hat(stretch) hat(rate)",
    signature="any law of one joint",
    parameters=(
        EffectParameter("height_n", "N", -1e5, 1e5, 10.0, "strength"),
        EffectParameter("stretch_m", "m", 1e-9, 10.0, 0.01),
        EffectParameter("rate_mps", "m/s", 1e-9, 100.0, 0.1),
        EffectParameter("at", "", -1.0, 1.0, 0.5),
        EffectParameter("speed", "", -1.0, 1.0, 0.5),
    ),
    constants=_constants,
    law=force,
)

SPEEDS: Final = (-1.0, 0.0, 1.0)


def surface(background: Background, without: LocalFit, site: str) -> Surface:
    """Fit the surface of one joint beside theta and the usual departures; its gain is in the events that choose."""
    joint = SEGMENTS.index(site)
    stretch, rate, linear_n = _reach(background, joint)
    knots = [(at, speed) for speed in SPEEDS for at in ACROSS]
    usual_n = SHARE * linear_n
    hats = [_hat(site, usual_n, stretch, rate, *knot) for knot in knots]
    heights = usual_n * _heights(background, hats)
    whole = [_hat(site, float(h), stretch, rate, *knot) for h, knot in zip(heights, knots, strict=True)]
    p = background.choose.products
    left = predicted(background.choose, _with(without.subject, whole)).left(without.departures)
    gain = float(mean_log_ratio(without.left, left[:, None], p.event, p.samples)[0])
    been = _been(background, joint, stretch, rate)
    force_n = np.where(been, heights.reshape(len(SPEEDS), len(ACROSS)), np.nan)
    return Surface(site, stretch * np.array(ACROSS), rate * np.array(SPEEDS), force_n, gain)


def _hat(site: str, height_n: float, stretch_m: float, rate_mps: float, at: float, speed: float) -> AppliedEffect:
    values = {"height_n": height_n, "stretch_m": stretch_m, "rate_mps": rate_mps, "at": at, "speed": speed}
    return AppliedEffect(HAT, site, values)


def _with(subject: Subject, effects: list[AppliedEffect]) -> Subject:
    return dataclasses.replace(subject, effects=(*subject.effects, *effects))


def _heights(background: Background, hats: list[AppliedEffect]) -> Floats:
    """Heights (h,) in usual ones: ridge regression beside the known columns."""
    train, weight = background.train, background.weight
    own = []
    for case, rows in zip(train.cases, train.rows, strict=True):
        plain = answer(background.subject, case)
        own.append(rows(np.stack([answer(background.subject, case, (hat,), plain) - plain for hat in hats], axis=2)))
    cross = np.einsum(
        "w,wkh->kh", weight, np.concatenate([k.transpose(0, 2, 1) @ o for k, o in zip(train.known, own, strict=True)])
    )
    square = np.einsum("w,whg->hg", weight, np.concatenate([o.transpose(0, 2, 1) @ o for o in own]))
    missed = [rows.missed(answer(background.subject, case)) for rows, case in zip(train.rows, train.cases, strict=True)]
    match = weight @ np.concatenate([np.einsum("wrh,wr->wh", o, y) for o, y in zip(own, missed, strict=True)])
    matrix = np.block([[background.normal(), cross], [cross.T, square + np.eye(len(hats))]])
    return np.asarray(np.linalg.solve(matrix, np.concatenate([weight @ train.products.miss, match]))[-len(hats) :])


def _reach(background: Background, joint: int) -> tuple[float, float, float]:
    """Stretch m, rate m/s and linear force N that the joint reaches in the events that are fitted to."""
    chain = Chain.of(background.subject)
    responses = [predict(background.subject, c.seat_mps2, c.rate_hz, c.channels) for c in background.train.cases]
    stretch = float(np.median([np.percentile(np.abs(r.displacement_m[:, joint]), REACH) for r in responses]))
    rate = float(np.median([np.percentile(np.abs(r.velocity_mps[:, joint]), REACH) for r in responses]))
    return stretch, rate, float(chain.stiffness_n_per_m[joint]) * stretch


def _been(background: Background, joint: int, stretch: float, rate: float) -> Flags:
    """Which knots (s, a) the joint comes near."""
    here = np.zeros((len(SPEEDS), len(ACROSS)), dtype=bool)
    for case in background.train.cases:
        response = predict(background.subject, case.seat_mps2, case.rate_hz, case.channels)
        u, w = response.displacement_m[:, joint] / stretch, response.velocity_mps[:, joint] / rate
        for i, speed in enumerate(SPEEDS):
            for j, at in enumerate(ACROSS):
                here[i, j] |= bool(((np.abs(u - at) < 0.25) & (np.abs(w - speed) < 0.5)).any())
    return here
