"""Surface: the missing force of a joint over its stretch and rate, as hat functions inside the chain.

If it gains where no effect of the catalogue is accepted, a law of this joint is missing. Without a gain the cause may
be memory, measurement or input, or a law of the rate: between the three knots of rate a law is a straight line, which
theta has absorbed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Flags, Floats
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.model import Chain, predict
from biodyn_core.effects import AppliedEffect, EffectParameter, Joint, JointForce
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.findings import Surface
from biodyn_core.tracing.local_fit import LocalFit, simulated_products
from biodyn_core.tracing.nuisance_model import NuisanceModel
from biodyn_core.tracing.screen import mean_log_ratio
from biodyn_core.tracing.settings import SurfaceSettings

ACROSS: Final = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Knots of stretch, in reaches of the joint; a hat is constant beyond the last knot.

The widths of a hat in `force` are the distances of these knots and of `SPEEDS`.
"""

SPEEDS: Final = (-1.0, 0.0, 1.0)
"""Knots of rate, in reaches of the joint."""


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


def surface(nuisance: NuisanceModel, without: LocalFit, site: str, settings: SurfaceSettings | None = None) -> Surface:
    """Fit the surface of one joint beside theta and nuisance parameters; the gain is in the events for choosing."""
    s = settings or SurfaceSettings()
    joint = SEGMENTS.index(site)
    stretch, rate, linear_n = _reach(nuisance, joint, s.reach_percent)
    knots = [(at, speed) for speed in SPEEDS for at in ACROSS]
    spread_n = s.height_spread * linear_n
    hats = [_hat(site, spread_n, stretch, rate, *knot) for knot in knots]
    heights = spread_n * _heights(nuisance, hats)
    whole = [_hat(site, float(h), stretch, rate, *knot) for h, knot in zip(heights, knots, strict=True)]
    subject = dataclasses.replace(without.subject, effects=(*without.subject.effects, *whole))
    products = simulated_products(nuisance.choose, subject)
    square = products.residual_square(without.coefficients)
    gain = float(mean_log_ratio(without.residual_square, square[:, None], products)[0])
    visited = _visited(nuisance, joint, stretch, rate)
    force_n = np.where(visited, heights.reshape(len(SPEEDS), len(ACROSS)), np.nan)
    return Surface(site, stretch * np.array(ACROSS), rate * np.array(SPEEDS), force_n, gain)


def _hat(site: str, height_n: float, stretch_m: float, rate_mps: float, at: float, speed: float) -> AppliedEffect:
    values = {"height_n": height_n, "stretch_m": stretch_m, "rate_mps": rate_mps, "at": at, "speed": speed}
    return AppliedEffect(HAT, site, values)


def _heights(nuisance: NuisanceModel, hats: list[AppliedEffect]) -> Floats:
    """Heights (h,) in prior spreads, by ridge regression beside the known columns."""
    train, weight = nuisance.train, nuisance.weight
    own = []
    for case, rows in zip(train.cases, train.rows, strict=True):
        plain = answer(nuisance.subject, case)
        own.append(rows(np.stack([answer(nuisance.subject, case, (hat,), plain) - plain for hat in hats], axis=2)))
    cross = np.einsum(
        "w,wkh->kh", weight, np.concatenate([k.transpose(0, 2, 1) @ o for k, o in zip(train.known, own, strict=True)])
    )
    square = np.einsum("w,whg->hg", weight, np.concatenate([o.transpose(0, 2, 1) @ o for o in own]))
    residuals = [
        rows.residual(answer(nuisance.subject, case)) for rows, case in zip(train.rows, train.cases, strict=True)
    ]
    match = weight @ np.concatenate([np.einsum("wrh,wr->wh", o, y) for o, y in zip(own, residuals, strict=True)])
    matrix = np.block([[nuisance.normal(), cross], [cross.T, square + np.eye(len(hats))]])
    return np.asarray(np.linalg.solve(matrix, np.concatenate([weight @ train.products.cross, match]))[-len(hats) :])


def _reach(nuisance: NuisanceModel, joint: int, percent: float) -> tuple[float, float, float]:
    """Reach of the joint in the events for fitting: stretch m, rate m/s and linear force N."""
    chain = Chain.of(nuisance.subject)
    responses = [predict(nuisance.subject, c.seat_mps2, c.rate_hz, c.channels) for c in nuisance.train.cases]
    stretch = float(np.median([np.percentile(np.abs(r.stretch_m[:, joint]), percent) for r in responses]))
    rate = float(np.median([np.percentile(np.abs(r.stretch_rate_mps[:, joint]), percent) for r in responses]))
    return stretch, rate, float(chain.stiffness_n_per_m[joint]) * stretch


def _visited(nuisance: NuisanceModel, joint: int, stretch: float, rate: float) -> Flags:
    """Whether the joint comes near each knot (s, a)."""
    here = np.zeros((len(SPEEDS), len(ACROSS)), dtype=bool)
    for case in nuisance.train.cases:
        response = predict(nuisance.subject, case.seat_mps2, case.rate_hz, case.channels)
        u, w = response.stretch_m[:, joint] / stretch, response.stretch_rate_mps[:, joint] / rate
        for i, speed in enumerate(SPEEDS):
            for j, at in enumerate(ACROSS):
                here[i, j] |= bool(((np.abs(u - at) < 0.25) & (np.abs(w - speed) < 0.5)).any())
    return here
