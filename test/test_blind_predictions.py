"""The study of predictions: its scores recover drawn spreads and planted misfits; its page states what is missed."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from paper import shipped
from provenances import with_spread

from biodyn_core.exposure.figure_spread import ACCEL_FACTORS, FORCE_FACTORS, SpreadFactors
from biodyn_core.pipeline.fit_monitor import MonitorSettings
from biodyn_core.signals.octaves import N_BANDS
from blind.predictions.calibrate import Calibration, calibrated
from blind.predictions.driven import WHOLE, Drive, Figures
from blind.predictions.page import HEAD, marks, rendered
from blind.predictions.people import _role
from blind.predictions.score import answer, condition_of, covered, scored

PROVENANCE = with_spread(shipped("subject_1"), share=0.1).provenance
SECONDS = 600


def figures(rng: np.random.Generator, factor: float, kind: str = "road", fitted: bool = True) -> Figures:
    """Figures of an error whose standard deviation is the factor for doses, and 1.4 times it for peaks, of a share.

    Of forces it is half of that.
    """
    share = 0.2
    sums = np.zeros((12, 4))
    sums[:, :2] = 5.0, 5.0 * share**2
    sums[:, 2:] = 25.0, 25.0 * share**2
    spread = share * factor * np.array([1.0, 1.0, 1.4, 0.5, 0.7, 0.7])[:, None]
    return Figures(kind, fitted, spread * rng.standard_normal((6, 6)), sums, np.full((6, 6), 0.95))


def drive(number: int = 0, kind: str = "", jump: float = 1.0, factor: float = 0.4, seconds: int = SECONDS) -> Drive:
    """A drive with a residual of the usual size that is `jump` times as large from its middle on."""
    rng = np.random.default_rng(number)
    predicted = np.ones((seconds, N_BANDS, 5))
    usual = N_BANDS * (0.02**2 + 0.1**2)
    late = (np.arange(seconds) >= seconds // 2)[:, None] & (np.arange(5) == 4)
    residual = usual * np.exp(0.3 * rng.standard_normal((seconds, 5))) * np.where(late & bool(kind), jump**2, 1.0)
    events = [*(figures(rng, factor) for _ in range(30)), figures(rng, factor, WHOLE)]
    begins_s = float(seconds // 2) if kind else 1e9
    return Drive(
        number, kind, 2.0 if kind else None, 5.0, dict(PROVENANCE), events, np.arange(float(seconds)), residual,
        predicted, begins_s, min(begins_s, float(seconds)), number == 7,
    )  # fmt: skip


def test_a_drive_is_read_back() -> None:
    given = drive(3, "gain", 3.0, seconds=20)
    given.figures[0].log_ratio[2, 3] = np.nan
    found = Drive.of_line(given.line())
    np.testing.assert_allclose(found.residual, given.residual, rtol=1e-4)
    np.testing.assert_allclose(found.figures[0].log_ratio, given.figures[0].log_ratio, rtol=1e-4)
    assert (found.kind, found.begins_s, found.provenance) == (given.kind, given.begins_s, dict(PROVENANCE))


@pytest.mark.parametrize(
    ("number", "case", "left_out", "role"),
    [(1, "road", "", "fit"), (2, "road", "rail", "fit"), (3, "rail", "", "held"), (4, "rail", "rail", "none"),
     (5, "rail", "rail", "drive")],
)  # fmt: skip
def test_roles_go_by_number_and_kind(number: int, case: str, left_out: str, role: str) -> None:
    planned: Any = SimpleNamespace(name=f"{case}_{number}", event=SimpleNamespace(case=case))
    assert _role(planned, left_out) == role


def test_conditions_go_by_turn() -> None:
    one = figures(np.random.default_rng(0), 1.0)
    found = [condition_of(one, number) for number in (0, 2, 3, 6, 15)]
    assert found == [
        "0.4 x the level of the fit", "0.4 x the level of the fit", "the level of the fit", "2 x the level of the fit",
        "0.4 x the level of the fit",
    ]  # fmt: skip
    assert condition_of(dataclasses.replace(one, fitted=False), 3) == "a kind of motion not in the fit"
    assert condition_of(dataclasses.replace(one, kind=WHOLE), 3) == "the whole drive"


def test_coverage_is_95_percent_where_errors_have_the_spread_of_the_package() -> None:
    found = list(scored(drive(number, factor=ACCEL_FACTORS.doses) for number in range(6)))
    assert len(found) == 6 * 31 * 36
    assert covered([one for one in found if one.figure in ("aw", "vdv")]) == pytest.approx(95.0, abs=1.5)
    for figure, ratio in (("peak", 1.4 / ACCEL_FACTORS.peaks), ("rms", 0.5 / FORCE_FACTORS.doses)):
        sigmas = 1.959964 / (ratio * ACCEL_FACTORS.doses)
        expected = 100.0 * math.erf(sigmas / math.sqrt(2.0))
        assert covered([one for one in found if one.figure == figure]) == pytest.approx(expected, abs=2.0)


@pytest.mark.slow
def test_the_factors_are_recovered() -> None:
    found = calibrated([drive(number, "" if number % 2 else "gain", 4.0, 0.3, seconds=150) for number in range(3)])
    assert vars(found.accel) == pytest.approx({"doses": 0.3, "peaks": 0.42}, rel=0.06)
    assert vars(found.force) == pytest.approx({"doses": 0.15, "peaks": 0.21}, rel=0.06)
    assert found.false_alarms == 0 and found.in_time == 1.0


def test_a_planted_misfit_is_found_and_an_early_alarm_is_false() -> None:
    found = answer(drive(1, "gain", 4.0))
    assert found.false_alarms == 0 and found.delay_s is not None and 10.0 <= found.delay_s <= 25.0 and found.in_time
    assert answer(drive(1, "gain", 1.0)).delay_s == math.inf
    assert answer(drive(1)).delay_s is None
    early = drive(2)
    early.residual[100:160, 0] *= 100.0
    assert answer(early).false_alarms >= 1
    assert answer(early, MonitorSettings(threshold=1e9)).false_alarms == 0


def test_the_page_states_what_is_missed() -> None:
    drives = [drive(number, "gain" if number else "", 4.0, factor=ACCEL_FACTORS.doses) for number in range(3)]
    alarms = "false alarms in 8 hours of drive without an effect"
    drives[0] = dataclasses.replace(drives[0], seconds=8 * 3600.0)
    by_name = {mark.what: mark.met for mark in marks(drives)}
    assert by_name["coverage, aw of a segment"] and by_name[alarms]
    drives[0].residual[100:160, 0] *= 100.0
    drives[0].residual[400:460, 0] *= 100.0
    assert not {mark.what: mark.met for mark in marks(drives)}[alarms]
    # Alarms in people who change are false too, and fewer than eight hours decide nothing.
    assert not {mark.what: mark.met for mark in marks([dataclasses.replace(drives[0], drifts=True)])}[alarms]
    few = {mark.what: mark for mark in marks(drives[1:])}[alarms]
    assert not few.met and few.reached == "0.0 (0 in 0.2 hours, too few)"
    calibration = Calibration(SpreadFactors(0.4, 0.5), SpreadFactors(0.2, 0.3), MonitorSettings(), 0, 3.0, 0.9)
    page = rendered(drives, calibration, "2026-01-01")
    assert page.startswith(HEAD) and "Run of 2026-01-01: 3 people, 8.2 hours" in page
    assert "| **no** |" in page and "| gain | 2 | 2 |" in page and f"| 0.400 | {ACCEL_FACTORS.doses:g} |" in page
