"""Screening finds what was done to data that another integrator made, and little where nothing was."""

import dataclasses
from functools import cache

import fitting
import numpy as np
import pytest
from scipy import signal
from test_effects import applied, twin

from biodyn_core.effects import CATALOGUE
from biodyn_core.identification.fit import Fit, fit_joint
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings
from biodyn_core.tracing.screen import Candidate, Screened, candidates, largest_by_chance, screen

QUICK = FitSettings(swarm=SwarmSettings(particles=30, iterations=60, starts=2), refined_starts=2)
NECK, HEAD = 3, 4


def cases(change) -> list[Case]:
    """The true recordings with noise, their measured segments (n, 5) changed."""
    rng, made = np.random.default_rng(4), []
    for recording in fitting.true_recordings(6.0)["segment"]:
        measured = change(recording.measured_mps2.copy())
        measured += fitting.low_passed(0.02 * rng.standard_normal(measured.shape))
        made.append(dataclasses.replace(recording, measured_mps2=measured))
    return [Case.of(recording, fitting.SPECTRUM, fitting.LINES) for recording in made]


def fitted(made: list[Case], clocks: str = "trusted") -> Fit:
    """Trusted, because a clock that is off is one of the things to be found."""
    return fit_joint(made, fitting.true_subjects()["segment"], 1, dataclasses.replace(QUICK, clocks=clocks))


def louder(measured: np.ndarray) -> np.ndarray:
    measured[:, NECK] *= 1.1
    return measured


def later(measured: np.ndarray) -> np.ndarray:
    time = np.arange(len(measured)) / fitting.RATE_HZ
    measured[:, HEAD] = np.interp(time - 0.004, time, measured[:, HEAD])
    return measured


def on_skin(measured: np.ndarray) -> np.ndarray:
    """30 Hz, a damping ratio of 0.3, by another discretisation than the package's."""
    w = 2.0 * np.pi * 30.0
    b, a = signal.bilinear([0.6 * w, w * w], [1.0, 0.6 * w, w * w], fitting.RATE_HZ)
    measured[:, HEAD] = signal.lfilter(b, a, measured[:, HEAD])
    return measured


@cache
def screened(change) -> list[Screened]:
    made = cases(change)
    return screen(fitted(made), made, candidates(made)[0])


@pytest.mark.parametrize(
    ("change", "name", "site"), [(louder, "gain", "neck"), (later, "clock", "head"), (on_skin, "skin", "head")]
)
def test_what_is_wrong_with_a_sensor_comes_first(change, name: str, site: str) -> None:
    best = screened(change)[0]
    assert (best.candidate.applied.effect.name, best.candidate.applied.site) == (name, site)
    assert best.gain > 0.5 and best.p_value < 0.05


def test_the_size_is_that_of_the_truth() -> None:
    best = screened(louder)[0]
    assert best.size * best.candidate.applied.values["gain"] == pytest.approx(0.1, rel=0.1)
    best = screened(later)[0]
    assert best.size * best.candidate.applied.values["delay_s"] == pytest.approx(0.004, rel=0.1)


def test_nothing_hidden_leaves_little_to_gain() -> None:
    made = cases(lambda measured: measured)
    found = screen(fitted(made), made, candidates(made)[0])
    assert found[0].gain < 0.02 and found[0].p_value > 0.05
    assert all(0.0 <= one.absorbed <= 1.0 + 1e-9 and one.score >= 0.0 for one in found)


def test_a_tissue_law_comes_first_in_what_another_integrator_made_of_it() -> None:
    """An orifice damper in the seat's joint, by DOP853 from full matrices."""
    subject = fitting.true_subjects()["segment"]
    effect = applied("quadratic_damping", "pelvis", growth_s_per_m=4.0)
    seat = fitting.seat_motion("pothole", 5.0, 3)
    made = [fitting.ready(seat, twin(effect, seat, subject, fitting.RATE_HZ), "pothole")]
    best = screen(fitted(made, "estimated"), made, candidates(made)[0])[0]
    assert (best.candidate.applied.effect.name, best.candidate.applied.site) == ("quadratic_damping", "pelvis")
    assert best.gain > 0.5


def test_a_candidate_that_runs_away_is_not_seen_and_spoils_no_other() -> None:
    made = cases(louder)
    runs_away = dataclasses.replace(CATALOGUE["gain"], measured=lambda accel, *_: np.full_like(accel, np.inf))
    gain = Candidate(applied("gain", "neck"), "gain")
    wild = Candidate(dataclasses.replace(gain.applied, effect=runs_away), "gain")
    fit = fitted(made)
    (alone,), both = screen(fit, made, [gain]), screen(fit, made, [wild, gain])
    assert both[0].candidate is gain and both[0].gain == pytest.approx(alone.gain, rel=1e-9)
    assert (both[1].gain, both[1].p_value, both[1].absorbed) == (0.0, 1.0, 1.0)


def test_chance_is_right_about_as_often_as_it_says() -> None:
    """Coloured residuals that follow the candidates' own input, 40 correlated candidates, nothing hidden."""
    rng, alarms = np.random.default_rng(8), 0
    for _ in range(200):
        drive = rng.standard_normal((40, 1, 60))
        shapes = np.concatenate([drive + 0.5 * rng.standard_normal((40, 1, 60)) for _ in range(40)], axis=1)
        loud = 1.0 + 4.0 * (rng.random((40, 1)) < 0.1)  # shocks are louder than the road
        residual = loud * np.cumsum(rng.standard_normal((40, 60)), axis=1) * 0.1
        windows = np.einsum("wkn,wn->wk", shapes, residual)
        energy, square = (shapes**2).sum(axis=(0, 2)), float((residual**2).sum())
        largest = largest_by_chance(windows, energy, square, 300, rng)
        gain = (windows.sum(axis=0) ** 2 / (energy * square)).max()
        alarms += gain > np.quantile(largest, 0.95)
    assert 1 <= alarms <= 20  # 10 of 200 are expected


def test_what_cannot_be_tested_is_named_not_passed_over() -> None:
    made = cases(lambda measured: measured)
    tried, untestable = candidates(made)
    assert {name.split(" at ")[0] for name in untestable} == {"bending", "cross_axis", "pitch", "tilt"}
    assert not {one.applied.effect.name for one in tried} & {"bending", "cross_axis", "pitch", "tilt"}
    names = ("seat.x", "seat.y", "seat.rate_x", "seat.rate_y", "neck.rate_y", "upper_torso.rate_y", "head.x", "head.y")
    full = [dataclasses.replace(case, channels=dict.fromkeys(names, case.seat_mps2)) for case in made]
    tried, untestable = candidates(full)
    assert {name.split(" at ")[0] for name in untestable} == {"tilt"}
    assert "tilt at head (lean_x)" in {one.name for one in tried}
