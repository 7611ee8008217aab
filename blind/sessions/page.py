"""The page of the study of sessions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from world.session import LEAST_G, ROAD_RMS_MPS2

from biodyn_core.base.wording import counted
from blind.requirements import Mark, mark_table
from blind.sessions.finding import NEAR_S, FindingScore
from blind.sessions.fitting import FitScore
from conformance.table import table

HEAD: Final = f"""\
# Sessions: are events found?

Made by `make blind ARGS=sessions`, which ends with an error if a requirement is missed. Do not edit.

`test/world` drives a seat for 40 minutes and more: roads of {ROAD_RMS_MPS2[0]:g} to {ROAD_RMS_MPS2[1]:g} m/s^2 rms with
a changing level, potholes of 0.4 to 3 g and railway crossings of 0.6 to 8 g at random times, 1.8 s and more apart, and
standstills, half of them with an engine that idles. The list of all of them is hidden from the search. A shock is found
if its time is right within {NEAR_S:g} s; a crossing has four strikes, and any time between them is right. Shocks below
{LEAST_G:g} g must not be reported. All settings of the search are the defaults. They were chosen on other sessions
of the same simulation, and on recorded trams and buses.

For the fits, people sit in such sessions, by the paper's equations and DOP853, with tilted, biased and noisy sensors of
one clock. Each person is fitted twice: on events that were found, and on events cut by hand with the hidden list, at
most eight of each condition. Both subjects predict another drive.
"""


def marks(found: FindingScore, fits: Sequence[FitScore]) -> list[Mark]:
    """All requirements."""
    hit, invented, right = found.found / found.planted, found.invented / found.all_found, found.right / found.events
    ratio = float(np.mean([fit.found_percent for fit in fits]) / np.mean([fit.by_hand_percent for fit in fits]))
    return [
        Mark(
            f"shocks of {LEAST_G:g} g and more found within {NEAR_S:g} s", ">= 95 %",
            f"{100 * hit:.1f} % ({found.found} of {found.planted})", hit >= 0.95,
        ),
        Mark(
            "reported shocks that were not planted", "<= 2 %",
            f"{100 * invented:.1f} % ({found.invented} of {found.all_found})", invented <= 0.02,
        ),
        Mark(
            "events with the right condition", ">= 90 %",
            f"{100 * right:.1f} % ({found.right} of {found.events})", right >= 0.9,
        ),
        Mark(
            "error in another drive, fit on found events over fit by hand", "<= 1.05", f"{ratio:.3f}", ratio <= 1.05
        ),
    ]  # fmt: skip


def rendered(sessions: Sequence[FindingScore], fits: Sequence[FitScore], date: str) -> str:
    """The page."""
    total = FindingScore.total(sessions)
    people = [
        ["person", "found events, %", "by hand, %", "truth, %", "ratio", "worst parameter, found", "by hand"],
        *(
            [str(number), f"{fit.found_percent:.2f}", f"{fit.by_hand_percent:.2f}", f"{fit.true_percent:.2f}",
             f"{fit.ratio:.3f}", f"{fit.found_theta_percent:.1f} %", f"{fit.by_hand_theta_percent:.1f} %"]
            for number, fit in enumerate(fits, 1)
        ),
    ]  # fmt: skip
    return "\n".join(
        [
            HEAD,
            f"Run of {date}: {counted(len(sessions), 'session')}, {total.seconds / 60.0:.0f} minutes in all.",
            f"{total.rests_found} of {total.rests} standstills are found as rests.",
            "",
            *mark_table(marks(total, fits)),
            "",
            "## Fits",
            "",
            "Mean error in the events of another drive, percent of the measured rms. Worst parameter: the largest",
            "distance of a natural frequency or damping ratio from the truth.",
            "",
            *table(people[0], people[1:]),
            "",
        ]
    )
