"""Interleaving: samples of several sensors in the order of their stamps, complete and bounded in lead."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biodyn_core.pipeline.interleaving import SLICE_S, in_stamp_order

START_NS = 1_767_225_600 * 10**9


def stamps(begin_s: float, seconds: float, rate_hz: float) -> np.ndarray:
    """Even stamps, ns."""
    return START_NS + np.round(1e9 * (begin_s + np.arange(round(seconds * rate_hz)) / rate_hz)).astype(np.int64)


def furthest_ahead_s(given: dict[str, np.ndarray], in_order: dict[str, np.ndarray]) -> float:
    """Largest time by which a sample follows a later one, by the stamps without faults, s."""
    newest_ns, ahead_ns = -(2**62), 0
    for name, part in in_stamp_order(given):
        here = in_order[name][part]
        ahead_ns = max(ahead_ns, newest_ns - int(here.min()))
        newest_ns = max(newest_ns, int(here.max()))
    return 1e-9 * ahead_ns


@given(
    begins=st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=6),
    rates=st.lists(st.sampled_from([100.0, 250.0, 1125.0]), min_size=6, max_size=6),
    seconds=st.lists(st.floats(0.0, 3.0), min_size=6, max_size=6),
)
def test_every_sample_comes_once_in_its_sensor_s_order_and_none_is_far_ahead(begins, rates, seconds) -> None:
    given_ns = {
        str(i): stamps(begin, length, rate)
        for i, (begin, length, rate) in enumerate(zip(begins, seconds, rates, strict=False))
    }
    order = in_stamp_order(given_ns)
    for name, one in given_ns.items():
        got = [one[part] for n, part in order if n == name]
        np.testing.assert_array_equal(np.concatenate(got) if got else np.empty(0), one)
    assert furthest_ahead_s(given_ns, given_ns) <= SLICE_S + 1e-6  # stamps this large lie 0.2 us apart as floats


@pytest.mark.parametrize("astray_ns", [-START_NS, -(10**10), 10**10, 10**18], ids=["unset", "before", "ahead", "wild"])
@pytest.mark.parametrize("at", [0, 700, -1])
def test_a_stray_stamp_delays_no_sensor(astray_ns: int, at: int) -> None:
    in_order = {name: stamps(0.0, 2.0, 1125.0) for name in ("head", "neck", "seat")}
    given_ns = {name: one.copy() for name, one in in_order.items()}
    given_ns["head"][at] += astray_ns
    assert furthest_ahead_s(given_ns, in_order) <= SLICE_S + 2e-3  # its own step counts as none


def test_a_common_leap_keeps_sensors_together() -> None:
    in_order = {name: stamps(begin, 2.0, 1125.0) for name, begin in (("head", 0.0), ("neck", 0.1), ("seat", 0.0))}
    given_ns = {name: np.where(one > START_NS + 12 * 10**8, one - 14 * 10**9, one) for name, one in in_order.items()}
    assert furthest_ahead_s(given_ns, in_order) <= SLICE_S + 2e-3


def test_an_empty_input_gives_an_empty_output() -> None:
    assert in_stamp_order({}) == in_stamp_order({"seat": np.empty(0, dtype=np.int64)}) == []
