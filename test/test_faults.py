"""The fault bench in stamp time: every fault is named, loses no more than it must, and is over in two seconds."""

from __future__ import annotations

import pytest

from biodyn_core.base.segments import SEAT, SENSORS
from faults.judged import judged
from faults.stamps import EVERY, OTHERS, Fault, dead, returning

ROWS = [*((fault, sensor) for fault in EVERY for sensor in SENSORS), *((f, s) for f in OTHERS for s in (SEAT, "head"))]


@pytest.mark.parametrize(("fault", "sensor"), ROWS, ids=[f"{sensor} {fault.name}" for fault, sensor in ROWS])
def test_no_crash_no_wrong_number_and_normal_again(fault: Fault, sensor: str) -> None:
    row = judged(fault, sensor)
    assert not row.wrong, row


WRONGLY = (
    (Fault("unnamed", returning, ("clipped",), (0.9, 1.1)), "nothing said of clipped"),
    (Fault("uncounted", returning, ("silent",), (0.0, 0.1)), "are called missing"),
    (Fault("for good", dead, ("silent",), (7.9, 8.1)), "it is not compared again"),
    (Fault("too much", lambda one: one.but(accel_mps2=1.3 * one.accel_mps2)), "without the fault"),
    (Fault("too late", lambda one: one.but(stamps_ns=one.stamps_ns + 10**7)), "predictions are off"),
)


@pytest.mark.parametrize(("fault", "said"), WRONGLY, ids=[fault.name for fault, _ in WRONGLY])
def test_the_judge_sees_what_is_wrong(fault: Fault, said: str) -> None:
    assert any(said in line for line in judged(fault, SEAT).wrong)
