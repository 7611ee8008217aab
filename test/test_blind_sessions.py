"""The study of sessions: its counts, its cuts by hand, and its page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from world.session import Planted, SessionMotion

from biodyn_core.sessions.findings import Event, Findings, Shock, Timeline
from blind.sessions.finding import FindingScore, apart_s, compared, conditions_at
from blind.sessions.fitting import LEAST_ROAD_S, FitScore, by_hand
from blind.sessions.page import HEAD, marks, rendered

PLANTED = (
    Planted("standstill", 0.0, 10.0),
    Planted("road", 10.0, 40.0),
    Planted("pothole", 40.0, 40.4, 40.1, 1.5),
    Planted("road", 40.4, 50.0),
    Planted("rail", 50.0, 50.8, 50.2, 2.0),
    Planted("road", 50.8, 51.9),
    Planted("pothole", 51.9, 52.0, 51.95, 0.5),
)


def event(begin_s: float, end_s: float, case: str, *times: float) -> Event:
    shocks = tuple(Shock(at, 10.0) for at in times)
    return Event(case, begin_s, end_s, case, 10.0, times[0] if times else begin_s, 1.0, 1.0, shocks, None, ())


def findings(*events: Event) -> Findings:
    return Findings(60.0, (), events, (), Timeline(0.02, np.zeros(1), np.zeros(1)), None, {}, {}, ())


def test_found_missed_and_invented_shocks_are_counted() -> None:
    """A time between the strikes of a train is right, one 0.2 s from a hole is not; a weak hole must not be found."""
    motion = SessionMotion(np.zeros((1, 3)), PLANTED)
    right = findings(event(12.0, 40.0, "road"), event(40.0, 42.0, "pothole", 40.15), event(48.0, 51.0, "rail", 50.7))
    assert compared(right, motion) == FindingScore(60.0, 2, 2, 2, 0, 3, 3, 1, 0)
    wrong = findings(event(40.0, 42.0, "rail", 40.3), event(51.0, 53.0, "pothole", 51.95))
    assert compared(wrong, motion) == FindingScore(60.0, 2, 0, 2, 2, 2, 1, 1, 0)
    assert apart_s(49.5, PLANTED[4]) == 0.5 and apart_s(50.5, PLANTED[4]) == 0.0
    assert conditions_at(event(20.0, 30.0, "road"), PLANTED) == {"road"}


def test_hand_cuts_have_lead_and_tail_and_do_not_overlap() -> None:
    parts = by_hand(Path("a"), PLANTED)
    assert [(part.case, part.begin_s, part.end_s) for part in parts] == [
        ("road", 13.0, 37.0), ("pothole", 37.0, 42.4), ("rail", 47.0, 52.8),
    ]  # fmt: skip
    assert LEAST_ROAD_S > 10.0


def test_the_page_states_what_is_missed() -> None:
    scores = [FindingScore(2400.0, 100, 96, 97, 1, 100, 95, 5, 5)] * 2
    fits = [FitScore(2.0, 1.9, 1.8, 0.5, 0.4)]
    assert [mark.met for mark in marks(FindingScore.total(scores), fits)] == [True, True, True, False]
    page = rendered(scores, fits, "2026-01-01")
    assert page.startswith(HEAD) and "| 96.0 % (192 of 200) | yes |" in page and "| 1.053 | **no** |" in page
