"""The page of the study of priors: docs/prior_study.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from biodyn_core.population.distribution import SPREAD
from blind.prior.fits import AMOUNTS, AMPLE, FitPair
from blind.prior.people import ORIGINS, STIFFENING_RANGE, WEAK_LEVEL
from blind.requirements import Mark, mark_table
from conformance.table import table

WORST: Final = 1.05
"""The largest allowed ratio of the errors with and without prior where data are ample."""

HEAD: Final = f"""\
# How much data a fit needs, without and with a prior

`biodyn fit --prior population` has published groups of people as prior ([fitting.md](fitting.md#few-data-a-prior)).

Made by `make blind ARGS=prior`, which ends with an error if a requirement is missed. Do not edit.

`test/world` simulates people, their surroundings and their sensors; it shares no code with the package. Half of the
people have theta of the population, with stiffening of {STIFFENING_RANGE[0]:g} to {STIFFENING_RANGE[1]:g}; the other
half have theta from anywhere in Table 1. Nearly all differ from the model in other ways too, so no theta describes them
exactly. Each person is fitted to several amounts of data, without and with the prior. Errors are those of predictions
of held-out road, potholes and rails, over the measured rms, mean of all sensors.
"""

WORDS: Final = {
    "population": "People of the population",
    "elsewhere": "People from anywhere in Table 1",
}


def marks(found: Sequence[FitPair]) -> list[Mark]:
    """All requirements."""
    result = []
    for origin in ORIGINS:
        ratios = [one.with_prior.error_percent / one.without.error_percent for one in _of(found, origin, AMPLE)]
        worst = max(ratios)
        what = f"{WORDS[origin]}, ample data: error with prior over error without, worst person"
        result.append(Mark(what, f"<= {WORST:g}", f"{worst:.3f}", worst <= WORST))
    return result


def rendered(found: Sequence[FitPair], date: str) -> str:
    """The page."""
    people = {one.person for one in found}
    parts = [
        HEAD, f"Run of {date}, {len(people)} people.\n",
        "\n".join(mark_table(marks(found))), "",
        *(_section(found, origin) for origin in ORIGINS), _intervals(found), _limits(),
    ]  # fmt: skip
    return "\n".join(parts).rstrip() + "\n"


def _of(found: Sequence[FitPair], origin: str, amount: str) -> list[FitPair]:
    return [one for one in found if one.origin == origin and one.amount == amount]


def _section(found: Sequence[FitPair], origin: str) -> str:
    """Medians by amount of data."""
    rows = []
    for amount in AMOUNTS:
        of = _of(found, origin, amount.name)
        ratios = [one.with_prior.error_percent / one.without.error_percent for one in of]
        rows.append(
            [
                amount.name,
                f"{np.median([one.without.error_percent for one in of]):.1f}",
                f"{np.median([one.with_prior.error_percent for one in of]):.1f}",
                f"{sum(ratio < 1.0 for ratio in ratios)} of {len(of)}",
                f"{max(ratios):.2f}",
                f"{np.median([one.without.parameter_error for one in of]):.2f}",
                f"{np.median([one.with_prior.parameter_error for one in of]):.2f}",
                f"{np.mean([one.from_prior for one in of]):.1f}",
            ]
        )
    group = np.median([one.group_percent for one in found if one.origin == origin])
    head = [
        "data", "error without, %", "error with, %", "better with", "worst ratio", "error of ln theta without", "with",
        "from the prior",
    ]  # fmt: skip
    lines = [
        f"## {WORDS[origin]}", "",
        f"Medians. The mean of the group, without any fit, has an error of {group:.1f} %. Error of ln theta: rms of",
        f"the {SPREAD.stop} parameters that the prior describes. Last column: parameters from the prior, mean.",
        "", *table(head, rows), "",
    ]  # fmt: skip
    return "\n".join(lines)


def _intervals(found: Sequence[FitPair]) -> str:
    """How many intervals of parameters contain the truth."""
    rows = []
    for amount in AMOUNTS:
        cells = [amount.name]
        for origin in ORIGINS:
            of = _of(found, origin, amount.name)
            for scores in ([one.without for one in of], [one.with_prior for one in of]):
                share = sum(one.inside for one in scores) / max(sum(one.intervals for one in scores), 1)
                cells.append(f"{100 * share:.0f} %")
        rows.append(cells)
    head = ["data", *(f"{name}, {how}" for name in ORIGINS for how in ("without", "with"))]
    lines = [
        "## Intervals of parameters", "",
        "Share of the 95 % intervals of parameters that contain the truth. Intervals do not allow for what the model",
        "lacks, and these people differ from it; [recovery.md](recovery.md) has people who do not.",
        "", *table(head, rows), "",
    ]  # fmt: skip
    return "\n".join(lines)


def _limits() -> str:
    return f"""\
## Limits

- The people of the population have the spread that the population assumes. Real people may differ more.
- A weak road has {WEAK_LEVEL:g} of the acceleration. A recording whose seat moves by less than 0.1 m/s^2 rms is
  refused.
"""
