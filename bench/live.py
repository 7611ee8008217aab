"""The live node over real DDS, three processes, compared with a node that passes the same messages without computing.

A publisher sends six Imu topics, the node responds, a subscriber receives predictions: as single samples on six topics,
in blocks, in blocks with measurements, or not at all. The baseline receives six topics and sends six topics of single
samples. All of them take turns. CPU is that of the node's process, without start-up.
"""

from __future__ import annotations

import dataclasses
import os
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.effects import general_law
from bench.processes import NODE, Answered, Window, streamed
from bench.table import Row, render
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.body import parameter_spread, usual_residual
from biodyn_core.body.parameter_spread import NAMES, ParameterSpread
from biodyn_core.body.subject import load_subject
from biodyn_core.body.synthesis_settings import NATIVE_RATE_HZ
from biodyn_core.body.usual_residual import UsualResidual
from biodyn_core.effects import CATALOGUE
from biodyn_core.signals.octaves import N_BANDS
from biodyn_ros.base.environment import prepare
from biodyn_ros.base.resources import subject_file

ROUNDS = 4
MEASURE_S = 8.0

BASELINE = "bare node, six single topics"
BARE = ("-m", "bench.graph", "minimal")
BARE_BLOCKS = ("-m", "bench.graph", "blocks")
WITH_MEASURED = (*NODE, "-p", "publish_measured:=true")

BLOCK_MS = 5.0
LATE_MS = 3.0
"""Allowed time of an answer beyond the length of a block, at the 99th percentile."""

SHARES = {
    "block": ("one block topic", NODE, 0.6),
    "single": ("six single topics", NODE, 1.15),
    "none": ("no subscriber", NODE, 0.5),
    "blocks": ("blocks of measurements too", WITH_MEASURED, 0.8),
}
"""By kind of subscriber: words, node, and the largest CPU over that of the baseline."""

FITTED = "fitted"
DEAREST = "dearest"
DEAREST_EFFECT = "lift_off"
"""The effect whose general law takes longest in `bench effects`."""

WITHOUT = "without"

FAST = (("single", 2.0), ("single", 3.0), ("block", 2.0), ("block", 3.0), ("block", 4.0))
"""Kinds of subscribers and multiples of the native rate at which nothing may be lost."""


def rows() -> list[Row]:
    """Measure; about six minutes."""
    domain = prepare(os.environ)  # None if the environment wrapper has reserved one
    with tempfile.TemporaryDirectory(prefix="biodyn-") as folder:
        try:
            sure, dearest = fitted_node(Path(folder)), effect_node(Path(folder), DEAREST_EFFECT)
            turns = [
                (
                    _run(BARE, "single"),
                    {kind: _run(SHARES[kind][1], kind) for kind in SHARES}
                    | {
                        FITTED: _run(sure, "block"),
                        DEAREST: _run(dearest, "block"),
                        WITHOUT: _run(BARE_BLOCKS, "block"),
                    },
                )
                for _ in range(ROUNDS)
            ]
            fast = [(kind, rate, _run(NODE, kind, rate)) for kind, rate in FAST]
        finally:
            if domain:
                domain.release()
    bare = _middle([one for one, _ in turns])
    ours = {kind: _middle([each[kind] for _, each in turns]) for kind in (*SHARES, FITTED, DEAREST, WITHOUT)}
    found = [row for kind in SHARES for row in _rows_of(kind, ours[kind], bare)]
    found += [
        _fitted_row(ours[FITTED], ours["block"]),
        _dearest_row(ours[DEAREST], ours["block"]),
        _without_row(ours[WITHOUT], bare),
    ]
    return [*found, *_memory_rows(ours["block"]), *(_fast_row(kind, rate, window) for kind, rate, window in fast)]


def _rows_of(kind: str, ours: Window, bare: Window) -> list[Row]:
    words, _, share = SHARES[kind]
    cpu, found = ours.cpu_percent, ours.found
    met = cpu <= share * bare.cpu_percent
    rows = [Row(f"live, {words}: CPU of one core", cpu, "%", bare.cpu_percent, BASELINE, f"<= {share:g} x", met)]
    if kind != "none":
        late = BLOCK_MS + LATE_MS
        rows += [
            _lost_row(f"live, {words}", found),
            Row(f"live, {words}: answer after sample, p50", found.p50_ms, "ms", bare.found.p50_ms, BASELINE, "-", None),
            Row(
                f"live, {words}: answer after sample, p99", found.p99_ms, "ms", bare.found.p99_ms, BASELINE,
                f"<= {late:g}", found.p99_ms <= late,
            ),
        ]  # fmt: skip
    return rows


def _fitted_row(ours: Window, plain: Window) -> Row:
    """The price of intervals and of the test of the residual."""
    name = "live, one block topic, a subject with intervals: CPU of one core"
    return Row(name, ours.cpu_percent, "%", plain.cpu_percent, "the same without intervals", "-", None)


def _dearest_row(ours: Window, plain: Window) -> Row:
    """The price of the dearest effect."""
    name = f"live, one block topic, a subject with {DEAREST_EFFECT}, general: CPU of one core"
    met = ours.cpu_percent <= 2.0 * plain.cpu_percent
    return Row(name, ours.cpu_percent, "%", plain.cpu_percent, "the same without an effect", "<= 2 x", met)


def _without_row(blocks: Window, bare: Window) -> Row:
    """What blocks cost without any mathematics: no live node in blocks can take less."""
    name = "live, one block topic, no mathematics: CPU of one core"
    return Row(name, blocks.cpu_percent, "%", bare.cpu_percent, BASELINE, "-", None)


def fitted_node(folder: Path) -> tuple[str, ...]:
    """The node with a subject that has a covariance and a usual residual."""
    subject = load_subject(subject_file("subject_1"))
    law = UsualResidual((0.02,) * N_BANDS, (1.0,) * N_BANDS, 100)
    provenance = {
        parameter_spread.PROVENANCE: ParameterSpread(NAMES[:-1], 1e-3 * np.eye(len(NAMES) - 1)).to_dict(),
        **usual_residual.to_provenance(dict.fromkeys(MEASURED_SEGMENTS, law)),
    }
    path = folder / "fitted.yaml"
    path.write_text(dataclasses.replace(subject, provenance=provenance).to_yaml(), encoding="utf-8")
    return (*NODE, "-p", f"subject_file:={path}")


def effect_node(folder: Path, name: str) -> tuple[str, ...]:
    """The node with a subject that has an effect in its general form."""
    subject = dataclasses.replace(load_subject(subject_file("subject_1")), effects=(general_law(CATALOGUE[name]),))
    path = folder / f"{name}.yaml"
    path.write_text(subject.to_yaml(), encoding="utf-8")
    return (*NODE, "-p", f"subject_file:={path}")


def _memory_rows(ours: Window) -> list[Row]:
    lost = ours.found.counted_lost
    return [
        Row("live: lost, as the node counts", lost, "messages", None, "", "0", lost == 0),
        Row("live: resident, warm cache", ours.resident_mb, "MB", None, "", "<= 300", ours.resident_mb <= 300.0),
        Row("live: publisher's own lateness, p99", ours.found.late_p99_ms, "ms", None, "", "-", None),
    ]


def _fast_row(kind: str, rate: float, window: Window) -> Row:
    return _lost_row(f"live, {SHARES[kind][0]}, {rate:g} x the rate", window.found)


def _lost_row(name: str, found: Answered) -> Row:
    return Row(f"{name}: lost of {found.owed:,} answers", found.lost, "messages", None, "", "0", found.lost == 0)


def _middle(runs: Sequence[Window]) -> Window:
    """Medians of the rounds, and sums of the losses."""
    found = {
        name: (sum if name in ("owed", "lost", "counted_lost") else statistics.median)(
            [getattr(run.found, name) for run in runs]
        )
        for name in Answered.__dataclass_fields__
    }
    cost = {
        name: statistics.median([getattr(run, name) for run in runs])
        for name in Window.__dataclass_fields__
        if name != "found"
    }
    return Window(**cost, found=Answered(**found))


# --- one run ---------------------------------------------------------------------------------------------------------


def _run(node: tuple[str, ...], kind: str, rate: float = 1.0) -> Window:
    """Measure a node while messages flow."""
    (window,) = streamed(node, kind, rate * NATIVE_RATE_HZ, [MEASURE_S])
    figures = {**vars(window), **vars(window.found)}
    values = ", ".join(f"{name} {value:.4g}" for name, value in figures.items() if name != "found")
    print(f"  {node[1]}, {kind}, {rate:g} x: {values}", file=sys.stderr, flush=True)
    return window


if __name__ == "__main__":
    print(render(rows()))
