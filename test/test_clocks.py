"""Clock drift against injected offsets, drifts, jitter, bursts and leaps."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biodyn_core.base.arrays import Integers
from biodyn_core.conditioning.clocks import ClockComparison, ClockDrift

START_NS = 1_700_000_000_000_000_000


def recording(
    seconds: float = 600.0,
    rate_hz: float = 200.0,
    ppm: float = 20.0,
    offset_s: float = 0.05,
    delay_s: float = 0.001,
    jitter_s: float = 0.0,
    burst_s: float = 0.0,
    seed: int = 0,
) -> tuple[Integers, Integers]:
    """Header stamps and log times of a sensor whose clock is `ppm` fast and `offset_s` behind at the start.

    Messages are delayed by an exponential time of mean `delay_s`, or written in bursts at most burst_s apart.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    log = t + rng.exponential(delay_s, t.size)
    if burst_s:
        writes = np.cumsum(rng.uniform(0.02, burst_s, int(seconds / 0.02)))
        log = writes[np.searchsorted(writes, t)] + 1e-6 * np.arange(t.size) / t.size
    stamps = t * (1.0 + 1e-6 * ppm) - offset_s + jitter_s * rng.normal(size=t.size)
    return START_NS + np.rint(stamps * 1e9).astype(np.int64), START_NS + np.rint(log * 1e9).astype(np.int64)


def compared(stamps_ns: Integers, log_ns: Integers, block: int | None = None) -> ClockDrift:
    clocks = ClockComparison()
    for lo in range(0, stamps_ns.size, block or stamps_ns.size):
        hi = lo + (block or stamps_ns.size)
        clocks.push(stamps_ns[lo:hi], log_ns[lo:hi])
    result = clocks.result()
    assert result is not None
    return result


def test_a_perfect_recording_is_exact_to_the_nanosecond() -> None:
    t = np.arange(60_000, dtype=np.int64) * 1_000_000
    # One microsecond gained in every second: the lag falls from 5 ms by 1e-6 of the time.
    found = compared(START_NS + t + t // 1_000_000, START_NS + t + 5_000_000)
    assert found.ppm == pytest.approx(1.0, abs=1e-3)
    assert found.offset_s == pytest.approx(0.005, abs=2e-6)
    assert found.scatter_s < 1e-8
    assert (found.leaps, found.quantum_s, found.copied) == (0, None, False)
    assert found.seconds == pytest.approx(60.0, abs=0.1)


@pytest.mark.parametrize("ppm", [-500.0, 0.0, 20.0])
@pytest.mark.parametrize(
    ("how", "ppm_within", "offset_within_s"),
    [
        ({}, 0.05, 0.0003),
        ({"rate_hz": 10.0, "delay_s": 0.01}, 2.0, 0.003),
        ({"jitter_s": 0.002}, 2.0, 0.008),
        ({"burst_s": 0.7}, 0.5, 0.003),
        ({"burst_s": 0.7, "jitter_s": 0.002}, 5.0, 0.008),
        ({"seconds": 60.0, "burst_s": 0.7}, 10.0, 0.003),
        ({"seconds": 7200.0, "rate_hz": 20.0}, 0.01, 0.0003),
    ],
    ids=lambda value: ",".join(f"{k}={v:g}" for k, v in value.items()) or "plain" if isinstance(value, dict) else None,
)
def test_injected_drift_and_offset_are_found(
    ppm: float, how: dict[str, float], ppm_within: float, offset_within_s: float
) -> None:
    for seed in range(2):
        found = compared(*recording(ppm=ppm, seed=seed, **how))
        assert found.ppm == pytest.approx(ppm, abs=ppm_within)
        assert found.offset_s == pytest.approx(0.05, abs=offset_within_s)
        assert found.leaps == 0


def test_the_interval_has_its_stated_coverage() -> None:
    found = [compared(*recording(60.0, 50.0, 20.0, jitter_s=0.002, seed=seed)) for seed in range(100)]
    inside = sum(abs(f.ppm - 20.0) <= f.ppm_error for f in found)
    assert 85 <= inside <= 100
    assert np.median([f.ppm_error for f in found]) < 30.0  # and it is not simply wide


def test_a_leap_is_counted_and_the_longest_stretch_fitted() -> None:
    stamps, log = recording()
    stamps[stamps.size // 3 :] += 3600 * 10**9
    found = compared(stamps, log)
    assert found.leaps == 1
    assert found.ppm == pytest.approx(20.0, abs=0.05)
    assert found.offset_s == pytest.approx(0.05 - 3600.0 - 200 * 20e-6, abs=1e-3)
    assert found.seconds == pytest.approx(400.0, abs=8.0)


def test_the_present_offset_is_of_the_stretch_since_the_leap() -> None:
    clocks, second = ClockComparison(), 10**9
    for number in range(600):
        stamp = number * second // 10
        late = 5_000_000 if number < 400 else 3 * second
        clocks.push(np.array([stamp]), np.array([stamp + late]))
    assert clocks.result().offset_s == pytest.approx(0.005, abs=1e-6)
    assert clocks.since_leap().offset_s == pytest.approx(3.0, abs=1e-6)
    assert ClockComparison().since_leap() is None


def test_stray_unset_duplicate_and_unordered_stamps_have_no_effect() -> None:
    stamps, log = recording()
    clean = compared(stamps, log)
    rng = np.random.default_rng(1)
    stray = rng.random(stamps.size) < 0.05
    stamps[stray] += rng.integers(-(10**13), 10**13, stray.sum())
    stamps[rng.random(stamps.size) < 0.1] = 0
    order = np.arange(stamps.size)
    for at in rng.integers(0, stamps.size - 2, 2000):
        order[[at, at + 1]] = order[[at + 1, at]]
    order = np.sort(np.concatenate([order, rng.integers(0, stamps.size, 2000)]))
    found = compared(stamps[order], log[order])
    assert found.leaps == 0
    assert found.ppm == pytest.approx(clean.ppm, abs=0.05)
    assert found.offset_s == pytest.approx(clean.offset_s, abs=1e-4)


@pytest.mark.parametrize("quantum_ms", [1, 10])
def test_quantised_stamps_are_reported_and_their_rate_is_found(quantum_ms: int) -> None:
    stamps, log = recording(rate_hz=233.0)
    quantum_ns = quantum_ms * 1_000_000
    quantised = stamps // quantum_ns * quantum_ns
    found = compared(quantised - 1, log)  # drivers that count in float seconds miss by a nanosecond
    assert found.quantum_s == pytest.approx(1e-3 * quantum_ms)
    assert found.ppm == pytest.approx(20.0, abs=max(found.ppm_error, 0.5))
    assert found.ppm_error < 5.0
    assert compared(stamps, log).quantum_s is None


def test_an_even_grid_is_not_quantised() -> None:
    stamps = START_NS + np.arange(6000) * 10_000_000
    stamps = np.delete(stamps, [100, 700, 701])
    assert compared(stamps, stamps + 1_000_000).quantum_s is None


def test_copied_log_times_are_recognised() -> None:
    stamps, _ = recording(60.0)
    assert compared(stamps, stamps).copied
    assert not compared(stamps, stamps + 1000).copied
    assert not compared(*recording(60.0)).copied


def test_constant_stamps_give_no_drift() -> None:
    _, log = recording(60.0)
    found = compared(np.full_like(log, START_NS), log)
    assert found.ppm is None or found.ppm < -1e5


def test_too_few_seconds_give_no_drift() -> None:
    clocks = ClockComparison()
    assert clocks.result() is None
    stamps, log = recording(3.0)
    clocks.push(np.zeros_like(stamps), log)
    assert clocks.result() is None
    clocks.push(stamps, log)
    found = clocks.result()
    assert found is not None
    assert (found.ppm, found.ppm_error) == (None, None)
    assert found.offset_s == pytest.approx(0.05, abs=1e-3)


def awkward(seed: int) -> tuple[Integers, Integers]:
    """Forty seconds with everything in it: unset, leaping and straying stamps, a log that steps back, bursts."""
    rng = np.random.default_rng(seed)
    stamps, log = recording(40.0, 100.0, jitter_s=0.003, burst_s=0.5, seed=seed)
    stamps[rng.integers(0, stamps.size, 50)] = 0
    stamps[rng.integers(0, stamps.size, 50)] += 10**12
    stamps[rng.integers(0, stamps.size) :] += int(rng.integers(-(10**13), 10**13))
    log[rng.integers(0, log.size) :] -= int(rng.integers(0, 30 * 10**9))
    return stamps, log


@given(st.integers(0, 50), st.lists(st.integers(0, 4000), max_size=12))
def test_any_cut_into_blocks_gives_the_same_bits(seed: int, cuts: list[int]) -> None:
    stamps, log = awkward(seed)
    whole = compared(stamps, log)
    clocks = ClockComparison()
    for lo, hi in zip([0, *sorted(cuts)], [*sorted(cuts), stamps.size], strict=True):
        clocks.push(stamps[lo:hi], log[lo:hi])
        clocks.result()  # asking changes nothing
    assert clocks.result() == whole


@pytest.mark.slow
def test_memory_does_not_grow_with_the_record() -> None:
    clocks, most = ClockComparison(), 0
    for hour in range(20):
        stamps, log = recording(3600.0, 20.0)
        clocks.push(stamps + hour * 3600 * 10**9, log + hour * 3600 * 10**9)
        clocks.result()
        most = max(most, len(pickle.dumps(clocks)))  # whatever it holds, it holds it here
    assert most < 100_000
    still = ClockComparison()  # a constant log clock ends no second
    for _ in range(100):
        still.push(np.arange(10_000) + START_NS, np.full(10_000, START_NS))
    assert len(pickle.dumps(still)) < 2_000_000  # of 16 million bytes that came
    assert still.result().ppm is None


@given(st.lists(st.tuples(st.integers(-(2**61), 2**61), st.integers(0, 2**61)), max_size=40))
def test_no_stamps_at_all_make_it_fail(pairs: list[tuple[int, int]]) -> None:
    clocks = ClockComparison()
    stamps, log = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    clocks.push(stamps, log)
    found = clocks.result()
    assert (found is None) == (not stamps.any())
    if found is not None:
        assert np.isfinite([found.offset_s, found.scatter_s, found.seconds]).all()
