"""The sending budget: a subscriber that hangs costs predictions, never exposure."""

import numpy as np
import pytest

from biodyn_ros.node.sending_budget import FIRST_PAUSE_S, LONGEST_PAUSE_S, SendingBudget

BLOCK_S = 0.005


class Sender:
    """Sends blocks of 5 ms, six samples each, for a time by a clock of its own."""

    def __init__(self) -> None:
        self.now_s, self.sent_s = 0.0, 0.0
        self.budget = SendingBudget(lambda: self.now_s)

    def stamps_ns(self) -> np.ndarray:
        """The stamps of the next block."""
        self.sent_s += BLOCK_S
        return np.rint(1e9 * (self.sent_s + BLOCK_S / 6.0 * np.arange(6))).astype(np.int64)

    def send(self, seconds: float, takes_s: float) -> int:
        """The number of blocks sent; takes_s: for each."""
        sent, end_s = 0, self.now_s + seconds
        while self.now_s < end_s:
            if self.budget.allows(6):
                sent += 1
                self.now_s += max(BLOCK_S, takes_s)
                self.budget.spend(takes_s, self.stamps_ns())
            else:
                self.now_s += BLOCK_S
        return sent


@pytest.mark.parametrize("takes_s", [0.0, 0.0007, 0.0049, 0.0099])
def test_all_is_sent_while_sending_takes_less_than_twice_the_motion(takes_s: float) -> None:
    sender = Sender()
    assert sender.send(10.0, takes_s) == pytest.approx(10.0 / max(BLOCK_S, takes_s), abs=2)
    assert not sender.budget.paused and sender.budget.unsent == 0


def test_slow_sending_pauses_ever_longer_and_ends_when_it_is_fast_again() -> None:
    sender = Sender()
    busy_s = 0.035 * sender.send(600.0, 0.035)
    assert sender.budget.paused and busy_s < 0.05 * 600.0
    assert sender.budget.unsent > 0.95 * 6 * 600.0 / BLOCK_S
    sender.send(2.0 * LONGEST_PAUSE_S, 0.0007)
    before = sender.budget.unsent
    assert not sender.budget.paused and sender.send(10.0, 0.0007) == pytest.approx(2000, abs=2)
    assert sender.budget.unsent == before
    # The next pause is a short one again.
    sender.send(0.6, 0.035)
    assert sender.budget.paused and sender.send(FIRST_PAUSE_S + 0.2, 0.0007) > 0


def test_one_block_that_takes_a_second_is_enough() -> None:
    sender = Sender()
    sender.send(0.2, 0.0007)
    sender.budget.spend(1.0, sender.stamps_ns())
    assert sender.budget.paused and not sender.budget.allows(6)
    sender.budget.end_pause()  # the subscriber has left
    assert not sender.budget.paused and sender.budget.allows(6)
