"""Compiled and plain Python give one answer, and the cache goes where its user may write."""

from __future__ import annotations

import importlib
import os
import pkgutil
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hiding import applied
from scipy import signal
from uncompiled import Uncompiled

from biodyn_core import kernels
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import LOWER, UPPER, Parameters
from biodyn_core.body.subject import Subject
from biodyn_core.conditioning.alignment import lagrange_weights
from biodyn_core.exposure.injury import DRI_DAMPING_RATIO, DRI_OMEGA_RAD_PER_S, first_order_hold
from biodyn_core.kernels import chain, compiling, generated, rails, sensor
from biodyn_core.signals.weighting import weighting_sections

RATE_HZ = 1129.3
ROWS = 260
INPUTS = ("random", "constant", "holes", "tiny", "zero", "one row", "no row")


def given(kind: str, columns: int) -> np.ndarray:
    """Input of every sort, (n, columns)."""
    rng = np.random.default_rng(INPUTS.index(kind))
    x = 10.0 * rng.standard_normal((ROWS, columns))
    if kind == "constant":
        x[:] = 9.81
    elif kind == "holes":
        x[rng.integers(0, ROWS, 20)] = np.nan
        x[rng.integers(0, ROWS, 5), rng.integers(0, columns, 5)] = np.nan
    elif kind == "tiny":
        x *= 1e-160  # squares reach denormal numbers, fourth powers vanish
    elif kind == "zero":
        x[:] = 0.0
    return np.ascontiguousarray(x[: {"one row": 1, "no row": 0}.get(kind, ROWS)])


def plain(function: Callable) -> Callable:
    """The kernel as ordinary Python; without numba it is that already."""
    return getattr(function, "py_func", function)


def answers(name: str, kind: str) -> list[np.ndarray]:
    """Run one kernel, as the module has it now, on fresh arrays; everything it returns or changes."""
    arguments = ARGUMENTS[name](kind)
    with np.errstate(all="ignore"):  # plain Python warns where compiled code does not
        returned = getattr(kernels, name)(*arguments)
    changed = [np.array(a, dtype=np.float64) for a in arguments if isinstance(a, np.ndarray)]
    return [*changed, np.array(np.nan if returned is None else returned, dtype=np.float64)]


def _follow_up(kind: str) -> list:
    rates, force = given(kind, 3), given(kind, 6)[:, 3:].copy()
    if not len(rates):  # callers have a sample
        rates = force = np.zeros((1, 3))
    return [rates, force, 1e-3, 0.01, np.tile([0.0, 0.6, 0.8], (len(rates), 1))]


def _tally(channels: int, columns: int) -> list:
    """Bin, total, ring, position and bin length."""
    arrays = [np.zeros((channels, columns)), np.zeros((channels, columns)), np.zeros((3, channels, columns))]
    return [*arrays, np.zeros(2, dtype=np.int64), 47]


def _chain(kind: str, keep_motion: bool, high: float) -> list:
    theta = LOWER + high * (UPPER - LOWER)
    chain = Chain.of(Subject("s", 70.0, 1.7, "segment", Parameters.from_vector(theta)))
    seat = given(kind, 1)[:, 0]
    step_s, stiffness = 1.0 / (RATE_HZ * chain.substeps(RATE_HZ)), chain.stiffness_n_per_m
    return [
        seat, np.empty((seat.size, 0)), np.linspace(-1e-3, 1e-3, 13),
        stiffness, chain.damping_n_s_per_m, stiffness * chain.stiffening_per_m, 1.0 / chain.inertia_kg,
        chain.rayleigh_rad_per_s, np.empty(0), step_s, 2, np.empty((seat.size, 6)),
        np.empty((seat.size, 18)) if keep_motion and seat.size else np.empty((0, 18)),
    ]  # fmt: skip


EPOCH_NS = 10**18


def _stream(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) ns with jitter, losses, a stall, some unset, an hour ahead or alike, a gap; samples of that kind."""
    samples = given(kind, 3)
    rng = np.random.default_rng(3)
    stamps = EPOCH_NS + np.rint((1.0 + np.arange(ROWS) + 0.05 * rng.standard_normal(ROWS)) * 1e9 / RATE_HZ).astype(int)
    stamps[60:] += round(5e9 / RATE_HZ)
    stamps[90:94] = stamps[94] + np.arange(4)
    stamps[110:113] = 0
    stamps[130:133] += 3600 * 10**9
    stamps[150:153] = stamps[150]
    stamps[190:] += 10**9
    return stamps[: len(samples)], samples


def _sensor(coarse: bool, jitter_s: float) -> np.ndarray:
    """A sensor's state after rest at 1 g: the clock at its epoch, a rotation, the low-pass, a tracker of 40 s."""
    state = np.zeros(sensor.STATE_SIZE)
    state[[sensor.PERIOD, sensor.NOMINAL]] = 1.0 / RATE_HZ
    state[sensor.JITTER], state[sensor.COARSE], state[sensor.SATURATION] = jitter_s, coarse, 20.0
    state[sensor.ROTATION : sensor.LOW_PASS] = np.eye(3)[[1, 2, 0]].ravel()
    state[sensor.LOW_PASS : sensor.LOW_PASS_STATE] = signal.butter(4, 100.0, fs=RATE_HZ, output="sos").ravel()
    state[[sensor.MAX_GAP, sensor.FLAT_AFTER, sensor.GAIN_TIME, sensor.GAIN_PERIOD]] = 0.05, 0.01, 2e-3, 1e-6
    state[sensor.TRACKER_GAIN], state[sensor.AT_REST : sensor.BEFORE] = 1.0 / (40.0 * RATE_HZ), (0.1, 0.2, 9.81)
    return state


def _regularise(kind: str, coarse: bool = False, jitter_s: float = 1e-5, final: bool = True) -> list:
    stamps, samples = _stream(kind)
    room = len(stamps) + 80
    return [
        stamps, samples, EPOCH_NS, final, _sensor(coarse, jitter_s), np.zeros(sensor.COUNT_SIZE, dtype=np.int64),
        np.zeros(room), np.zeros((room, 3)), np.zeros(room, dtype=np.int64),
    ]  # fmt: skip


def _condition(kind: str, coarse: bool = False, jitter_s: float = 1e-5, final: bool = True) -> list:
    stamps, samples = _stream(kind)
    room = len(stamps) + 80
    return [
        stamps, samples, EPOCH_NS, 4_050_000, final, _sensor(coarse, jitter_s),
        np.zeros(sensor.COUNT_SIZE, dtype=np.int64), np.zeros(room, dtype=np.int64), np.zeros(room),
        np.zeros((room, 3)), np.zeros((room, 1)), np.zeros((room, 3)), np.zeros(room, dtype=np.int64),
    ]  # fmt: skip


def _find_rails(kind: str) -> list:
    samples = np.clip(np.round(4.0 * np.nan_to_num(given(kind, 3)), 2), -19.6, 19.6)
    source = np.where(np.arange(len(samples)) % 50 == 7, -1, np.arange(len(samples)))
    rows, counts = np.zeros(rails.STATE_SIZE), np.zeros(rails.COUNT_SIZE, dtype=np.int64)
    return [samples, source, np.zeros(3), True, 25.0, rows, counts]


def _filter_sections(kind: str) -> list:
    x = given(kind, 2)
    sections = weighting_sections("Wk", RATE_HZ)
    return [sections, np.zeros((len(sections), 2, 2)), x, np.empty_like(x)]


def _interpolate(kind: str) -> list:
    values = given(kind, 1)[:, 0]
    times = np.arange(values.size) / RATE_HZ
    runs = (np.arange(values.size) > 130).astype(np.int64)
    grid = np.sort(np.append(np.linspace(-0.01, 0.25, 300), times[20:40]))
    return [times, runs, values, grid, lagrange_weights(8), np.full(grid.size, np.nan)]


def _dose(kind: str) -> list:
    sections = weighting_sections("Wk", RATE_HZ)
    state = np.zeros((len(sections), 2, 2))
    window = 40.6  # samples, so that its block is full several times
    means = [1e-3, np.zeros(2), np.zeros((2, 42)), np.zeros(2), np.zeros(1, dtype=np.int64), window]
    x = given(kind, 2)
    lost = np.tile(np.where(np.arange(len(x)) % 40 < 5, 5, 0)[:, None], (1, 2))
    suspects = [lost, 1.0, np.array([4, 5, 20]), np.tile([2**62, 0, 2**62, 0, 0, 0], (2, 1))]
    return [x, sections, state, 2e-3, np.full(2, 0.3), *means, *suspects, *_tally(2, 7)]


def _planar_dose(kind: str) -> list:
    sections = weighting_sections("Wd", RATE_HZ)
    return [given(kind, 2), sections, np.zeros((len(sections), 2, 2)), 2e-3, np.full(2, 0.3), *_tally(1, 9)]


def _dynamic_response(kind: str) -> list:
    hold = first_order_hold(DRI_OMEGA_RAD_PER_S, DRI_DAMPING_RATIO, 1.0 / RATE_HZ)
    return [given(kind, 1), hold, np.zeros(3), *_tally(1, 2), np.zeros(2, dtype=np.int64)]


def _head_injury(kind: str) -> list:
    x = np.abs(given(kind, 3))
    weights = np.append(np.arange(1, 17) / RATE_HZ, 0.015) ** -0.6
    outputs = [np.zeros((3, 2), dtype=np.int64), np.zeros(1, dtype=np.int64), np.zeros((3, 2))]
    return [x, 1.0 / RATE_HZ, 0.015, weights, np.zeros((3, 2, 36)), *outputs, *_tally(3, 1)]


def _level(kind: str) -> list:
    x = given(kind, 3)
    turn = np.linalg.qr(np.arange(9.0).reshape(3, 3) ** 2 + np.eye(3))[0]
    return [x, turn, np.array([0.3, -0.2, 9.81]), np.empty_like(x)]


def _settle(kind: str) -> list:
    sections = weighting_sections("Wk", RATE_HZ)
    level = given(kind, 1).sum()
    return [sections, np.ones((len(sections), 2, 2)), 1, float(level)]


def _residual(kind: str) -> list:
    x = given(kind, 4)
    return [np.ascontiguousarray(x[:, :2]), np.ascontiguousarray(x[:, 2:]), *_tally(2, 3)]


def _flag_suspect(kind: str) -> list:
    x = given(kind, 3)
    lost = np.where(np.arange(len(x)) % 40 < 5, 5, 0)
    state = np.array([2**62, 0, 2**62, 0])
    return [x, lost, 2.0, 1e-3, 3, 4, 5, 20, np.full(3, 0.1), state, np.zeros(len(x), dtype=bool)]


def _loss() -> list:
    """Readings, place and largest of an open loss."""
    return [np.linspace(1.0, 4.0, 6), np.array([2, 0, 0]), np.zeros(1)]


def _find_losses(kind: str) -> list:
    x = given(kind, 1)[:, 0]
    lost = np.where(np.arange(len(x)) % 40 < 5, 5, 0)
    return [np.nan_to_num(x), lost, 3, 4, *_loss(), 0.5, np.zeros(2)]


ARGUMENTS: dict[str, Callable[[str], list]] = {
    "integrate_chain": lambda kind: _chain(kind, keep_motion=True, high=0.5),
    "regularise": _regularise,
    "condition": _condition,
    "find_rails": _find_rails,
    "level": _level,
    "filter_sections": _filter_sections,
    "first_invalid": lambda kind: [given(kind, 6), 0.1 * given(kind, 12), 2.5],
    "interpolate": _interpolate,
    "dose": _dose,
    "planar_dose": _planar_dose,
    "dynamic_response": _dynamic_response,
    "head_injury": _head_injury,
    "residual": _residual,
    "flag_suspect": _flag_suspect,
    "find_losses": _find_losses,
    "begin_loss": lambda kind: [7, *_loss(), 0.5, np.zeros(2)],
    "end_loss": lambda kind: [np.array([0, 7, 2]), np.full(1, 4.0), 0.5, np.zeros(2)],
    "peak_forces": lambda kind: [given(kind, 4), *_tally(4, 4)],
    "set_steady_state": _settle,
    "follow_attitude": _follow_up,
}
ELSEWHERE = ("biodyn_core.kernels.cost", "biodyn_core.kernels.surrogate")
"""Compared in test_objectives, which has their inputs."""


def test_every_kernel_is_compared():
    if not kernels.COMPILED:
        pytest.skip("without numba there is nothing to compare")
    modules = [importlib.import_module(f"{kernels.__name__}.{m.name}") for m in pkgutil.iter_modules(kernels.__path__)]
    public = {
        name
        for module in modules
        for name, value in vars(module).items()
        if hasattr(value, "py_func") and not name.startswith("_") and value.__module__ not in ELSEWHERE
    }
    assert public == set(ARGUMENTS)


@pytest.mark.parametrize("name", ARGUMENTS)
@pytest.mark.parametrize("kind", INPUTS)
def test_compiled_and_plain_kernels_agree(name, kind, monkeypatch):
    compiled = answers(name, kind)
    with monkeypatch.context() as patch:
        Uncompiled(patch)
        twin = answers(name, kind)
    for one, other in zip(compiled, twin, strict=True):
        # Contracted multiplications may differ in the last bit; a tally near the smallest number in all of them.
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("high", [0.0, 1.0])
@pytest.mark.parametrize("keep_motion", [False, True])
def test_the_chain_agrees_at_both_ends_of_table_1(high, keep_motion, monkeypatch):
    monkeypatch.setitem(ARGUMENTS, "integrate_chain", lambda kind: _chain(kind, keep_motion, high))
    test_compiled_and_plain_kernels_agree("integrate_chain", "random", monkeypatch)


@pytest.mark.parametrize("coarse", [False, True])
@pytest.mark.parametrize("jitter_s", [0.0, 1e-3])
@pytest.mark.parametrize("final", [False, True])
@pytest.mark.parametrize("kind", ["random", "constant", "holes"])
@pytest.mark.parametrize(("name", "arguments"), [("regularise", _regularise), ("condition", _condition)])
def test_a_sensors_path_agrees_for_any_clock(name, arguments, coarse, jitter_s, final, kind, monkeypatch):
    monkeypatch.setitem(ARGUMENTS, name, lambda kind: arguments(kind, coarse, jitter_s, final))
    test_compiled_and_plain_kernels_agree(name, kind, monkeypatch)


def test_the_streams_path_is_used_in_every_part():
    """Or else the comparison would compare little."""
    stamps, samples, epoch_ns, final, state, counts, *out = _regularise("holes")
    used, _, why = sensor.regularise(stamps, samples, epoch_ns, final, state, counts, *out)
    assert used >= 190 and why == sensor.NEW_RUN
    *of_rails, rows, counts_at_extremes = _find_rails("random")
    rails.find_rails(*of_rails, rows, counts_at_extremes)
    assert rows.reshape(rails.ROWS, -1)[:, rails.FOUND].any() and (counts_at_extremes[1:] > 0).sum() > 10
    names = ("ACCEPTED", "UNSET", "NON_FINITE", "LATE", "STRAY", "FILLED", "CLIPPED", "TRACKED")
    assert [name for name in names if counts[getattr(sensor, name)] == 0] == []


def test_states_of_effects_are_integrated_as_the_motion_is(monkeypatch):
    """A state of its own that decays has one factor per step, that of the Runge-Kutta method, in any cut."""
    rates = np.array([0.0, 90.0, 700.0])
    Uncompiled(monkeypatch)
    bare = chain._accelerations

    def decaying(x, v, q, *others):
        bare(x, v, q, *others)
        others[-2][:] = -rates[: q.size] * q

    monkeypatch.setattr(chain, "_accelerations", decaying)
    arguments = _chain("random", keep_motion=False, high=0.5)
    seat, step_s, substeps, size = arguments[0][:40], arguments[9], arguments[10], 40
    alone, state = np.linspace(-1e-3, 1e-3, 13), np.append(np.linspace(-1e-3, 1e-3, 13), [2.0, -1.0, 0.5])
    apart, cut = np.empty((size, 6)), np.empty((size, 6))
    chain.integrate_chain(seat, arguments[1], state, *arguments[3:11], apart, arguments[12])
    for begin, end in ((0, 13), (13, size)):
        chain.integrate_chain(seat[begin:end], arguments[1], alone, *arguments[3:11], cut[begin:end], arguments[12])
    z = rates * step_s
    factor = 1.0 - z + z**2 / 2.0 - z**3 / 6.0 + z**4 / 24.0
    np.testing.assert_allclose(state[13:], [2.0, -1.0, 0.5] * factor ** (size * substeps), rtol=1e-12)
    assert abs(factor[2] - np.exp(-z[2])) > 1e-7  # it is the method, not the exact solution
    np.testing.assert_array_equal(state[:13], alone)
    np.testing.assert_array_equal(apart, cut)


def test_an_integrator_without_cache_or_compiler_equals_the_compiled_one(monkeypatch):
    """... with states, a delay and a limit, each of whose lines is written into its source."""
    effects = [applied(name) for name in ("relaxation", "reflex", "lift_off")]
    body = Chain.of(Subject("s", 70.0, 1.7, "segment", Parameters.from_vector(0.5 * (LOWER + UPPER))))
    body = body.with_effects(effects)
    seat = 30.0 * np.sin(np.arange(60) / 8.0)
    compiled = body.simulate(seat, RATE_HZ).accel_mps2
    Uncompiled(monkeypatch)
    monkeypatch.setattr(compiling, "numba", None)
    monkeypatch.setattr(generated, "CACHE", None)
    monkeypatch.setattr(generated, "_load", generated._load.__wrapped__)
    monkeypatch.setattr(generated, "_integrator", generated._integrator.__wrapped__)
    plain = body.simulate(seat, RATE_HZ).accel_mps2
    np.testing.assert_allclose(plain, compiled, rtol=1e-9, atol=1e-9 * abs(compiled).max())


def test_a_generated_file_that_python_cannot_import_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(generated, "CACHE", str(tmp_path))
    monkeypatch.setattr(generated, "cached_file", lambda path, text: path.with_suffix(".text"))
    with pytest.raises(ImportError, match=r"chain_[0-9a-f]{32}\.text: cannot be loaded"):
        generated._load("# no integrator\n")


@pytest.mark.parametrize("missing", ["switched off", "not installed"])
def test_without_numba_functions_stay_as_they_are(missing, bare, monkeypatch):
    monkeypatch.setenv("HOME", str(bare))
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1" if missing == "switched off" else "0")
    if missing == "not installed":
        monkeypatch.setitem(sys.modules, "numba", None)
    module = runpy.run_path(compiling.__file__)
    assert module["COMPILED"] is False
    for decorate in (module["compiled"], module["inlined"]):
        assert decorate(given) is given


# --- decisions of a sensor's path ------------------------------------------------------------------------------------

PERIOD_NS = round(1e9 / RATE_HZ)


def _on_time(number: int) -> int:
    """The stamp of a sample on time, ns; the first one is one period behind the epoch."""
    return EPOCH_NS + (number + 1) * PERIOD_NS


@pytest.mark.parametrize(
    ("later", "needed", "coarse", "final", "wanted"),
    [
        ([_on_time(5000 + k) for k in range(1, 4)], 3, False, False, "CONFIRMED"),
        ([_on_time(5000 + k) for k in range(1, 3)], 3, False, False, "UNDECIDED"),
        ([_on_time(5000 + k) for k in range(1, 3)], 3, False, True, "CONFIRMED"),
        ([_on_time(5000 + k) for k in range(1, 3)], 20, False, True, "OUTLIER"),  # too few for a leap so far
        ([_on_time(k) for k in range(1, 4)], 3, False, True, "OUTLIER"),  # back on the old line, behind the leap
        ([_on_time(5000)] * 30, 3, False, True, "OUTLIER"),  # constant
        ([0] * 450, 3, False, True, "OUTLIER"),  # no stamp in reach decides
        ([0] * 399 + [_on_time(5001)], 1, False, True, "CONFIRMED"),  # the last one in reach does
        ([0] * 400 + [_on_time(5001)], 1, False, True, "OUTLIER"),  # the next one does not
        ([0, 0], 1, False, True, "OUTLIER"),
        ([_on_time(5000)] * 2, 1, False, False, "UNDECIDED"),  # repeated messages
        ([_on_time(4999 - k) for k in range(25)], 20, False, True, "OUTLIER"),
    ],
)
@pytest.mark.parametrize("as_python", [False, True])
def test_later_stamps_confirm_a_leap_or_do_not(later, needed, coarse, final, wanted, as_python):
    confirm = plain(sensor._confirm_leap) if as_python else sensor._confirm_leap
    state = _sensor(coarse, 1e-5)
    state[sensor.PERIOD], state[sensor.TIME] = 1e-9 * PERIOD_NS, 0.0
    stamps = np.array([_on_time(5000), *later], dtype=np.int64)
    assert confirm(stamps, 0, needed, EPOCH_NS, final, state) == getattr(sensor, wanted)


def test_a_leap_that_later_stamps_never_pass_is_an_outlier():
    """Coarse stamps that repeat the leap are as near to it as to nothing: after 20 of them it is none."""
    state = _sensor(True, 1e-5)
    state[sensor.PERIOD], state[sensor.TIME] = 1e-9 * PERIOD_NS, 0.0
    leap = _on_time(5000)
    pairs = [leap + (k % 2) - 1 for k in range(40)]
    confirm = plain(sensor._confirm_leap)
    assert confirm(np.array([leap, *pairs]), 0, 20, EPOCH_NS, True, state) == sensor.OUTLIER


@pytest.mark.parametrize("as_python", [False, True])
def test_instants_on_samples_between_them_and_none_are_interpolated(as_python):
    """A polynomial of the interpolation's degree is exact; without instants nothing is done."""
    interpolate = plain(kernels.interpolate) if as_python else kernels.interpolate
    times, runs = np.arange(20.0), np.zeros(20, dtype=np.int64)
    values, grid = (times - 8.0) ** 3, np.array([5.0, 7.25, 9.5, 10.0])
    out = np.full(4, np.nan)
    assert interpolate(times, runs, values, grid, lagrange_weights(4), out) == 4
    np.testing.assert_allclose(out, (grid - 8.0) ** 3, rtol=1e-12)
    assert interpolate(times, runs, values, grid[:0], lagrange_weights(4), out[:0]) == 0


@pytest.mark.parametrize("as_python", [False, True])
def test_short_outputs_stop_a_stream_where_it_continues_unchanged(as_python, monkeypatch):
    if as_python:
        Uncompiled(monkeypatch)
    stamps, samples, epoch_ns, final, state, counts, *out = _regularise("random")
    used, size, why = sensor.regularise(stamps, samples, epoch_ns, final, state, counts, *out)
    assert why == sensor.NEW_RUN
    whole, *_, again, counted, times, accel, source = [used, *_regularise("random")]
    parts, begin, why, calls = [], 0, sensor.DONE, 0
    while why == sensor.DONE:
        short = times[:70], accel[:70], source[:70]
        read, written, why = sensor.regularise(stamps[begin:], samples[begin:], epoch_ns, final, again, counted, *short)
        parts.append([short[0][:written].copy(), short[1][:written].copy()])
        begin, calls = begin + read, calls + 1
    assert begin == whole and calls > 10
    for part, long in zip(zip(*parts, strict=True), out, strict=False):
        np.testing.assert_array_equal(np.concatenate(part), long[:size])
    np.testing.assert_array_equal(counted, counts)


@pytest.mark.parametrize("as_python", [False, True])
def test_a_sample_too_many_is_left_out_once_the_mean_of_stamps_shows_it(as_python, monkeypatch):
    if as_python:
        Uncompiled(monkeypatch)
    stamps, samples, epoch_ns, final, state, counts, times, accel, source = _regularise("random")
    counts[sensor.TRACKED] = 10**6  # a clock that is known, so that it does not follow the stamps
    stamps = np.array([_on_time(k) for k in range(len(stamps))])
    extra = 150
    stamps[extra:] -= round(0.95 * PERIOD_NS)
    used, written, why = sensor.regularise(stamps, samples, epoch_ns, final, state, counts, times, accel, source)
    assert (used, written, why) == (len(stamps), len(stamps) - 1, sensor.DONE)
    assert (counts[sensor.LATE], counts[sensor.FILLED], counts[sensor.ACCEPTED]) == (1, 0, len(stamps) - 1)
    (dropped,) = np.setdiff1d(np.arange(len(stamps)), source[:written])
    assert extra < dropped < extra + 20
    late = times[:written] - 1e-9 * (stamps[source[:written]] - epoch_ns)
    assert abs(late[-40:]).max() < 0.3e-9 * PERIOD_NS < abs(late[extra + 1 : dropped]).min()


@pytest.mark.parametrize("as_python", [False, True])
def test_levels_next_to_an_extreme_are_counted_in_order(as_python):
    """... each with the number of its readings, and the lowest is lost to a new one."""
    insert = plain(rails._insert_level) if as_python else rails._insert_level
    row = np.zeros(rails.ROW_SIZE)
    row[rails.EXTREME], row[rails.READ] = 20.0, 1.0
    for value in (15.0, 18.0, 15.0, 13.0, 18.0 * (1.0 + 1e-7), 15.0 * (1.0 - 1e-7), 14.0, 13.0):
        insert(value, row)
    assert row[: rails.READ].tolist() == [20.0, 18.0, 15.0, 14.0, 13.0, 0.0, 0.0, 0.0, 0.0]
    assert row[rails.READ : rails.FOUND].tolist() == [1.0, 2.0, 3.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0]
    for value in (19.0, 17.0, 16.0, 12.5, 13.5):
        insert(value, row)
    assert row[: rails.READ].tolist() == [20.0, 19.0, 18.0, 17.0, 16.0, 15.0, 14.0, 13.5, 13.0]
    assert row[rails.READ : rails.FOUND].tolist() == [1.0, 1.0, 2.0, 1.0, 1.0, 3.0, 1.0, 1.0, 2.0]


@pytest.mark.parametrize(("stays", "found"), [(33, 0.0), (34, 1.0)])
def test_a_rail_is_found_from_single_stays_in_plain_python(stays, found):
    """34 stays beside 8 levels that were read once each: the binomial probability is below 9^-9."""
    row = np.zeros(rails.ROW_SIZE)
    row[rails.READ + 1 : rails.FOUND], row[rails.STAYS] = 1.0, stays
    plain(rails._test_rail)(row)
    assert row[rails.FOUND] == found


# --- the cache -------------------------------------------------------------------------------------------------------


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """No variable that names a cache, and a temporary folder of the test's own."""
    for variable in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    (tmp_path / "tmp").mkdir()
    return tmp_path


@pytest.fixture
def closed(tmp_path):
    """A path that is not writable even for root: its parent is a file."""
    (tmp_path / "file").write_text("", encoding="utf-8")
    return str(tmp_path / "file" / "below")


def test_the_user_chooses_the_cache_directory(bare, monkeypatch):
    monkeypatch.setenv("HOME", str(bare / "home"))
    assert compiling.cache_folder() == str(bare / "home" / ".cache" / "biodyn")
    monkeypatch.setenv("XDG_CACHE_HOME", str(bare / "xdg"))
    assert compiling.cache_folder() == str(bare / "xdg" / "biodyn")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(bare / "numba"))
    assert compiling.cache_folder() == str(bare / "numba" / "biodyn")


def test_without_home_the_cache_is_temporary_and_the_users_own(bare):
    folder = Path(compiling.cache_folder())
    assert folder.parent == bare / "tmp" and folder.name.startswith("biodyn-cache-")
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"])
def test_an_unwritable_cache_directory_is_skipped(bare, closed, monkeypatch, variable):
    monkeypatch.setenv(variable, closed)
    assert Path(compiling.cache_folder()).parent == bare / "tmp"


def test_a_read_only_directory_is_skipped(bare, monkeypatch):
    def refuse(dir):  # noqa: A002 - the name tempfile has
        raise PermissionError(dir)

    monkeypatch.setenv("HOME", str(bare))
    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    assert compiling.cache_folder() is None


def test_a_directory_of_another_user_is_skipped(bare, monkeypatch):
    if not hasattr(os, "getuid"):
        pytest.skip("no owners here")
    monkeypatch.setenv("HOME", str(bare))
    monkeypatch.setattr(os, "getuid", lambda: 4_000_001)
    assert compiling.cache_folder() is None


def test_without_a_writable_directory_there_is_no_cache(bare, closed, monkeypatch):
    monkeypatch.setenv("HOME", closed)
    monkeypatch.setattr(tempfile, "tempdir", closed)
    assert compiling.cache_folder() is None


SCRIPT = """
import sys
{block}
import numpy as np
from biodyn_core import kernels
from biodyn_core.kernels.compiling import CACHE
out = np.empty((3, 1))
kernels.filter_sections(np.array([[0.5, 0.5, 0, 1, 0, 0]]), np.zeros((1, 2, 1)), np.array([[1.0], [2.0], [4.0]]), out)
print(kernels.COMPILED, CACHE, out.ravel().tolist())
"""


@pytest.mark.parametrize(
    "block", ["", "sys.modules['numba'] = None", "import os; os.environ['NUMBA_DISABLE_JIT'] = '1'"]
)
def test_kernels_run_without_home_cache_or_numba(closed, block):
    if not block and not kernels.COMPILED:
        pytest.skip("numba is not here")
    environment = {"PATH": os.environ["PATH"], "TMPDIR": closed, "HOME": closed, "XDG_CACHE_HOME": closed}
    setup = f"import tempfile; tempfile.tempdir = {closed!r}; {block}"
    root = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT.format(block=setup)],
        env=environment, cwd=root, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.split(maxsplit=2) == [str(not block), "None", "[0.5, 1.5, 3.0]\n"], done.stderr
