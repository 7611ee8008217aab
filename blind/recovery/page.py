"""The page: marks, both methods, people, parameters, and the errors of the unmeasured central torso."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.parameters import PARAMETERS
from blind.recovery.draw import HELD_OUT_S, TRAINING_S
from blind.recovery.marks import WITHIN_FLOOR, better, marks, ours_error, papers_error
from blind.recovery.results import MethodResult, PersonResult, largest_frequency_error
from conformance.table import cells

Floats = NDArray[np.float64]

HEAD: Final = f"""\
# Recovery

Made by `make blind`, which ends with an error if a requirement is missed. Do not edit. Except for the seconds, the page
is the same in each run on one machine with the same libraries. On another machine digits of the paper's method changed,
none of ours.

People are drawn uniformly from the whole of Table 1, half of them with each mass matrix. Each rides through six events:
road, pothole and rail-like shocks, {TRAINING_S:g} s each for the fit, and once more {HELD_OUT_S:g} s each, held out.
Seat motions are alternately synthetic and recorded in vehicles, and the held-out ones the opposite: a person who was
fitted on a synthetic road is tested on a recorded one. Recordings (tram and bus 500 Hz, car 104 Hz, potholes 50 Hz) are
resampled to the rate of the truth without content above their band, and scaled to the levels of the paper, their
horizontal motion included.

`test/world` simulates people, vehicles and sensors and shares no code with the package: the paper's equations
integrated by DOP853 with a smooth seat motion; six IMUs tilted by up to 12 degrees, noise and bias 0.05 m/s^2, sixteen
bits; clocks off by 0.2 ms, 20 ppm and 0.02 ms of jitter (rms). Raw streams go through `Recorder`, `fit_joint` and
`uncertainty`, all with their defaults. Answers and their classification are complete before the truth is read.

The floor is the error of the true subject through the same pipeline. m_scale cancels from accelerations and is omitted.
The simulated model has the same form as ours, so this page does not test what the model lacks.
"""


def rendered(people: Sequence[PersonResult]) -> str:
    """The whole page."""
    parts = (_marks, _methods, _classified, _parameters, _torso, _people)
    return "\n".join([HEAD, *(line for part in parts for line in part(people))]).rstrip() + "\n"


def _table(title: str, words: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [cells(*head), cells("---", *["---:"] * (len(head) - 1)), *(cells(*row) for row in rows)]
    return [f"## {title}", "", *([words, ""] if words else []), *lines, ""]


def _marks(people: Sequence[PersonResult]) -> list[str]:
    rows = [(m.what, m.required, m.reached, "met" if m.met else "**missed**", m.papers) for m in marks(people)]
    words = (
        "After the coverage its own 95 % interval, by resampling whole people; parameters on a bound have no interval."
    )
    return _table("Marks", words, ("mark", "required", "reached", "", "the paper's method"), rows)


def _methods(people: Sequence[PersonResult]) -> list[str]:
    ours, papers = [p.ours for p in people], [p.papers for p in people]
    floor = float(np.mean([p.floor.error_percent.mean() for p in people]))
    rows = [
        ("held-out error, mean", *(f"{np.mean([w.error_percent.mean() for w in ws]):.2f} %" for ws in (ours, papers))),
        (
            "... over the floor, median person's largest",
            f"{np.median([p.ratio.max() for p in people]):.2f}",
            f"{np.median([p.papers_ratio.max() for p in people]):.2f}",
        ),
        ("error of f_n of joints 1, 2, 5, 6, median person's largest", *map(_largest, (ours, papers))),
        ("error of all 14 parameters, median", *map(_median_error, (ours, papers))),
        ("seconds, median", *(f"{np.median([w.seconds for w in ws]):.1f}" for ws in (ours, papers))),
    ]
    nearer = sum(ours_error(p) < papers_error(p) for p in people)
    words = (
        f"Ours, the default, is `fit_joint` with its uncertainty; the paper's is `PAPER` case by case and fused. The"
        f" floor's mean held-out error is {floor:.2f} %. Ours predicts better in {nearer} of {len(people)} people:"
        f" **{'our method stays the default' if better(people) else 'the default should be that of the paper'}**."
    )
    return _table("Both methods", words, ("", "ours", "the paper's"), rows)


def _largest(methods: Sequence[MethodResult]) -> str:
    return f"{100.0 * np.median([largest_frequency_error(one) for one in methods]):.2f} %"


def _median_error(methods: Sequence[MethodResult]) -> str:
    return f"{100.0 * np.median([np.abs(one.log_ratio) for one in methods]):.2f} %"


def _classified(people: Sequence[PersonResult]) -> list[str]:
    each = [
        (e.identifiability if not e.at_bound else "on a bound", bool(held), e.half_width, abs(off))
        for p in people
        for e, held, off in zip(p.estimates, p.inside, p.ours.log_ratio, strict=True)
    ]
    rows = []
    for degree in ("identifiable", "weakly identifiable", "not identifiable", "on a bound"):
        group = [one for one in each if one[0] == degree]
        if not group:
            rows.append((degree, "0", "-", "-", "-", "-"))
            continue
        held, half, off = (np.array([one[i] for one in group], dtype=float) for i in (1, 2, 3))
        shown = ("-", "-") if degree == "on a bound" else (f"{100.0 * held.mean():.1f} %", _percent(np.median(half)))
        rows.append((degree, str(len(group)), *shown, _percent(np.median(off)), _percent(off.max())))
    return _table(
        "Identifiability",
        "Parameters of all people by their classification before the truth was read. Half widths and errors are"
        " relative.",
        ("classification", "parameters", "coverage", "half width, median", "error, median", "error, largest"),
        rows,
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f} %"


def _parameters(people: Sequence[PersonResult]) -> list[str]:
    rows = []
    for i, parameter in enumerate(PARAMETERS[:14]):
        own = [p for p in people if p.counted[i]]
        off = np.array([abs(p.ours.log_ratio[i]) for p in people])
        rows.append(
            (
                parameter.name,
                f"{sum(p.inside[i] for p in own)} of {len(own)}",
                _percent(np.median([p.estimates[i].half_width for p in own])),
                _percent(np.median(off)),
                _percent(off.max()),
                _percent(np.median([abs(p.papers.log_ratio[i]) for p in people])),
                str(sum(p.estimates[i].identifiability == "identifiable" for p in people)),
            )
        )
    head = ("parameter", "inside", "half width, median", "error, median", "error, largest", "paper's error, median",
            "identifiable")  # fmt: skip
    return _table("Parameters", "", head, rows)


def _torso(people: Sequence[PersonResult]) -> list[str]:
    ours = np.array([p.ours.unseen_percent for p in people])
    floor = np.array([p.floor.unseen_percent for p in people])
    difference = np.array([p.difference_percent for p in people])
    rows = []
    for s, name in enumerate(SEGMENTS):
        half = [np.median([p.estimates[i].half_width for p in people if p.counted[i]]) for i in (s, s + 6)]
        off = [np.median([abs(p.ours.log_ratio[i]) for p in people]) for i in (s, s + 6)]
        rows.append(
            (
                f"{name}{', not measured' if name == 'central_torso' else ''}",
                f"{np.median(floor[:, :, s]):.2f} %",
                f"{np.median(ours[:, :, s]):.2f} %",
                f"{(ours / floor)[:, :, s].max():.2f}",
                f"{np.median(difference[:, :, s]):.2f} %",
                *(_percent(value) for pair in zip(half, off, strict=True) for value in pair),
            )
        )
    words = (
        "Held-out predictions against the true motion of each segment, with the joint below it. The central torso is"
        " predicted and not measured; joints 3 and 4, on either side of it, are known only in series. The floor is that"
        " of the true subject; the difference between our predictions and its predictions is the error of the fit."
    )
    head = ("segment", "floor, median", "ours, median", "ours over floor, largest", "from the true subject, median",
            "f_n half width", "f_n error", "zeta half width", "zeta error")  # fmt: skip
    return _table("The central torso", words, head, rows)


def _people(people: Sequence[PersonResult]) -> list[str]:
    rows = [
        (
            str(number),
            p.mass_matrix,
            ", ".join(p.truth.training),
            f"{p.ratio.max():.2f}",
            f"{100.0 * largest_frequency_error(p.ours):.2f} %",
            str(sum(e.identifiability == "identifiable" for e in p.estimates)),
            f"{np.count_nonzero(p.inside & p.counted)} of {np.count_nonzero(p.counted)}",
            f"{ours_error(p):.2f} %",
            f"{p.ours.seconds:.1f}",
            f"{p.papers_ratio.max():.2f}",
            f"{100.0 * largest_frequency_error(p.papers):.2f} %",
            f"{papers_error(p):.2f} %",
            f"{p.papers.seconds:.1f}",
        )
        for number, p in enumerate(people, 1)
    ]
    head = ("person", "mass matrix", "road, pothole, rail", "largest over floor", "largest f_n error", "identifiable",
            "inside", "error", "s", "paper's: largest over floor", "largest f_n error", "error", "s")  # fmt: skip
    words = (
        f"Largest over floor: of all held-out events and segments, {WITHIN_FLOOR:g} are allowed; largest error of f_n:"
        " of joints 1, 2, 5, 6; error: mean of the held-out events."
    )
    return _table("People", words, head, rows)
