"""Effects: the cost of each in the integrator, and the time of a process to its first result with one."""

from __future__ import annotations

import dataclasses
import os
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np

from bench.table import Row, render
from biodyn_core.body.model import Chain, Stepper
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.synthesis import load_case
from biodyn_core.body.synthesis_settings import NATIVE_RATE_HZ
from biodyn_core.effects import CATALOGUE, AppliedEffect, ChainEffect, Effect
from biodyn_ros.base.resources import subject_file

SECONDS = 5.0
GENERAL = 0.7
"""Distance of the values of a general law from the textbook form, in spreads; a tenth of the range without one."""

REPEATS = 15
WARM = 5
FIRST = """
import dataclasses, numpy as np
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.body.model import Chain
from biodyn_core.body.subject import load_subject
from biodyn_ros.base.resources import subject_file
effect = CATALOGUE["viscera"]
applied = AppliedEffect(effect, effect.sites[0], {p.name: p.size for p in effect.parameters})
subject = dataclasses.replace(load_subject(subject_file("subject_1")), effects=EFFECTS)
Chain.of(subject).simulate(np.sin(np.arange(500) / 30.0), 1129.3)
"""


def rows() -> list[Row]:
    """Measure; about a minute, most of it compiling."""
    subject = load_subject(subject_file("subject_1"))
    seat = load_case("rail", SECONDS, np.random.default_rng(0), NATIVE_RATE_HZ).accel_mps2[:, 2]
    effects = [effect for effect in CATALOGUE.values() if isinstance(effect, ChainEffect)]
    textbook = {effect.name: _share(subject, textbook_law(effect), seat) for effect in effects}
    general = {effect.name: _share(subject, general_law(effect), seat) for effect in effects}
    cold_s, warm_s, without_s, bare_s = _first_results_s()
    return [
        *_share_rows("textbook laws", textbook, 2.0),
        *_share_rows("general laws", general, None),
        Row("process to first result, nothing cached", cold_s, "s", bare_s, "imports alone", "<= 3", cold_s <= 3.0),
        Row("... compiled before, above its imports", warm_s - bare_s, "s", without_s - bare_s, "without an effect",
            "<= 0.5", warm_s - bare_s <= 0.5),
    ]  # fmt: skip


def _share_rows(which: str, shares: dict[str, float], most: float | None) -> list[Row]:
    """The median and the dearest of the times with an effect over that without."""
    dearest = max(shares, key=lambda name: shares[name])
    found = {f"5 s with one effect, {which}, median": statistics.median(shares.values())}
    found[f"... the dearest, {dearest}"] = shares[dearest]
    required = "-" if most is None else f"<= {most:g}"
    return [
        Row(name, share, "x", 1.0, "without", required, None if most is None else share <= most)
        for name, share in found.items()
    ]


def textbook_law(effect: Effect) -> AppliedEffect:
    """An effect of typical size at its last site, in its textbook form."""
    return AppliedEffect(effect, effect.sites[-1], {one.name: one.size for one in effect.textbook_parameters})


def general_law(effect: Effect) -> AppliedEffect:
    """The same with all parameters of its general law, so that every part of it is computed."""
    values = textbook_law(effect).values
    for one in effect.parameters:
        if one.neutral is not None:
            away = one.neutral + (GENERAL * one.spread or 0.1 * (one.upper - one.lower))
            values = {**values, one.name: min(max(away, one.lower), one.upper)}
    return AppliedEffect(effect, effect.sites[-1], values)


def _share(subject: Subject, applied: AppliedEffect, seat: np.ndarray) -> float:
    """Time with an effect over time without, which take turns."""
    with_it = dataclasses.replace(subject, effects=(applied,))
    channels = dict.fromkeys(applied.effect.required_channels(applied.site), 0.1 * seat)
    steppers = [Stepper(Chain.of(one), NATIVE_RATE_HZ) for one in (with_it, subject)]
    times: list[list[float]] = [[], []]
    for _ in range(REPEATS + 1):
        for stepper, spent in zip(steppers, times, strict=True):
            stepper.reset()
            start = time.perf_counter()
            stepper.push(seat, channels=channels)
            spent.append(time.perf_counter() - start)
    ours, base = (min(spent[1:]) for spent in times)  # the first compiles
    return ours / base


def _first_results_s() -> tuple[float, float, float, float]:
    """Seconds of a process with an empty cache; compiled before, with an effect, without, and the imports alone."""
    imports = "".join(line + "\n" for line in FIRST.splitlines() if "import" in line)
    programs = (FIRST.replace("EFFECTS", "(applied,)"), FIRST.replace("EFFECTS", "()"), imports)
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        cold_s, *_ = (_process_s(program, environment) for program in programs)
        rounds = [[_process_s(program, environment) for program in programs] for _ in range(WARM)]
    warm_s, without_s, bare_s = (statistics.median(times) for times in zip(*rounds, strict=True))
    return cold_s, warm_s, without_s, bare_s


def _process_s(program: str, environment: dict[str, str]) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", program], env=environment, check=True)
    return time.perf_counter() - start


if __name__ == "__main__":
    print(render(rows()))
