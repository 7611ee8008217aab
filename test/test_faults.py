"""The fault bench in stamp time: every fault is reported, with a bounded loss and recovery within two seconds.

`make faults` has every fault on more sensors.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle

import pytest

from biodyn_core.base.segments import SEAT
from faults import drive
from faults.judged import judged, reference
from faults.stamps import EVERY, OTHERS, Fault, dead, returning

ROWS = [*((fault, sensor) for fault in EVERY for sensor in (SEAT, "head")), *zip(OTHERS, cycle((SEAT, "head")))]


@pytest.fixture(autouse=True, scope="module")
def _long_blocks() -> Iterator[None]:
    """Blocks of the greatest length that a live node may have: a fifth of the blocks of `make faults`."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(drive, "SLOT_S", 0.1)
        reference.cache_clear()
        yield
    reference.cache_clear()


@pytest.mark.parametrize(("fault", "sensor"), ROWS, ids=[f"{sensor} {fault.name}" for fault, sensor in ROWS])
def test_faults_are_reported_without_wrong_numbers_and_recover(fault: Fault, sensor: str) -> None:
    row = judged(fault, sensor)
    assert not row.wrong, row


WRONG = (
    (Fault("unnamed", returning, ("clipped",), (0.9, 1.1)), "no message with clipped"),
    (Fault("uncounted", returning, ("silent",), (0.0, 0.1)), "are reported missing"),
    (Fault("for good", dead, ("silent",), (7.9, 8.1)), "it is not compared again"),
    (Fault("too much", lambda one: one.but(accel_mps2=1.3 * one.accel_mps2)), "without the fault"),
    (Fault("too late", lambda one: one.but(stamps_ns=one.stamps_ns + 10**7)), "predictions differ"),
)


@pytest.mark.parametrize(("fault", "error"), WRONG, ids=[fault.name for fault, _ in WRONG])
def test_errors_are_found(fault: Fault, error: str) -> None:
    assert any(error in line for line in judged(fault, SEAT).wrong)
