"""Scores of the blind tracing study: ratio, oracle, placebo, and the share of the gap that an answer closes."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from blind_answers import SUBJECT
from world.effects.sitting import Plan, drawn

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.body.model import predict
from biodyn_core.body.subject import Subject
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.identification.fit import Fit, fit_joint
from biodyn_core.identification.phase1 import SwarmSettings
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import FitSettings
from blind.tracing import refits, score
from blind.tracing.outcome import Answer, Cause, Score
from blind.tracing.records import Record, record
from blind.tracing.refits import oracle, placebo
from blind.tracing.rows import Drawing
from blind.tracing.score import generic_percent, ratio, recovered, sum_of_squares, unseen

QUICK = FitSettings(swarm=SwarmSettings(particles=20, iterations=20, starts=1), refined_starts=1, evaluations=100)


def test_energy_recovered_is_a_share_of_the_oracles() -> None:
    assert recovered(10.0, 4.0, 2.0, right=True) == pytest.approx(0.75)
    assert recovered(10.0, 4.0, 2.0, right=False) == 0.0
    assert recovered(2.0, 1.0, 1.99, right=True) is None


def event(subject: Subject, number: int, seconds: float = 3.5) -> Case:
    """The response of a subject to a synthetic seat motion, with little noise."""
    rate_hz, rng = 250.0, np.random.default_rng(number)
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    tones = rng.uniform(2.0, 20.0, 8)
    seat = (2.0 * np.sin(2.0 * np.pi * tones * time_s[:, None] + rng.uniform(0.0, 6.0, 8))).sum(axis=1)
    measured = predict(subject, seat, rate_hz).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    measured = measured + 0.02 * rng.standard_normal(measured.shape)
    compared = np.zeros(measured.shape, dtype=bool)
    compared[round(2.0 * rate_hz) :] = True
    measured = np.where(compared, measured, 0.0)
    frequency = np.arange(1.0, 30.0)
    nothing = np.zeros((frequency.size, 5))
    return Case(f"road_{number}", "road", rate_hz, seat, measured, compared, (measured**2).sum(axis=0), frequency,
                nothing, nothing, ())  # fmt: skip


@pytest.fixture(scope="module")
def backrest() -> tuple[Record, Record]:
    """A person without and with a backrest, in the same three events."""
    values = {"stiffness_n_per_m": 6000.0, "damping_s": 0.01, "friction_n": 0.0, "smooth_mps": 0.01}
    leans = AppliedEffect(CATALOGUE["backrest"], "upper_torso", values)
    found = []
    for effects in ((), (leans,)):
        cases = [event(dataclasses.replace(SUBJECT, effects=effects), number) for number in range(3)]
        found.append(Record(SUBJECT, tuple(cases[:2]), tuple(cases[2:])))
    return found[0], found[1]


@pytest.fixture(scope="module")
def fit(backrest: tuple[Record, Record]) -> Fit:
    """The person with the backrest, fitted without one."""
    return fit_joint(backrest[1].train, SUBJECT, 0, QUICK)


@pytest.mark.slow
def test_refits_give_ratio_oracle_placebo_and_generic(
    backrest: tuple[Record, Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, hidden = backrest
    # Sensors' effects alone, so that no integrators have to be compiled.
    monkeypatch.setattr(refits, "CATALOGUE", {name: CATALOGUE[name] for name in ("backrest", "clock", "skin")})
    fits = [fit_joint(known.train, SUBJECT, 0) for known in (hidden, plain)]
    assert ratio(fits[1].subject, plain.cases, fits[1].subject, plain.cases) == 0.0
    visible = ratio(fits[0].subject, hidden.cases, fits[1].subject, plain.cases)
    assert visible > 1.0
    truth = Cause("backrest", "upper_torso", "backrest")
    before, best, wrong = (
        sum_of_squares(subject, hidden.held_out)
        for subject in (fits[0].subject, oracle(fits[0], hidden.train, truth), placebo(fits[0], hidden.train, truth))
    )
    floor = sum_of_squares(fits[1].subject, plain.held_out)
    assert best < 5.0 * floor < 0.03 * before  # friction, of which it has none, is neared and never reached
    assert wrong > best
    named = Answer("strong", 0, "effect", unseen=("road_2", "gone"))
    both = dataclasses.replace(plain, held_out=plain.cases)
    assert [case.name for case in unseen(named, both).held_out] == ["road_2"]
    assert unseen(dataclasses.replace(named, unseen=()), both).held_out == plain.cases
    assert math.isfinite(generic_percent(fits[0], hidden))


def test_an_unstable_simulation_has_infinite_squares() -> None:
    quiet = event(SUBJECT, 0)
    for factor in (1e5, 1e160):
        wild = dataclasses.replace(quiet, seat_mps2=factor * quiet.seat_mps2)
        assert sum_of_squares(SUBJECT, [quiet]) < 0.01 < sum_of_squares(SUBJECT, [quiet, wild]) == math.inf


def test_the_error_of_an_unstable_oracle_is_infinite(
    backrest: tuple[Record, Record], fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, hidden = backrest
    wild = dataclasses.replace(hidden.held_out[0], seat_mps2=1e160 * hidden.held_out[0].seat_mps2)
    known = dataclasses.replace(hidden, held_out=(wild,))
    monkeypatch.setattr(score, "oracle", lambda *given: SUBJECT)
    monkeypatch.setattr(score, "placebo", lambda *given: None)
    found = score._beside(Score("strong", 0, (Cause("backrest", "upper_torso", "backrest"),)),
                          Answer("strong", 0, "none"), known, fit)  # fmt: skip
    assert (found.oracle_percent, found.placebo_percent) == (math.inf, None)


@pytest.mark.parametrize("fails", ["ceiling", "oracle"])
def test_a_refit_that_fails_does_not_take_the_ratio(
    fails: str, backrest: tuple[Record, Record], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The ratio decides the rows of a record, and a miss must stay in them."""

    def refuse(*_: object) -> None:
        raise InputError("gap_m is nan")

    plain, hidden = backrest
    cause = Cause("backrest", "upper_torso", "backrest")
    theta = tuple(SUBJECT.parameters.vector().tolist())
    monkeypatch.setattr(score, "causes", lambda effects: (cause,))
    monkeypatch.setattr(score, "record", lambda one, coloured, with_effects: hidden if with_effects else plain)
    monkeypatch.setattr(score, "_base_fit", lambda known: SimpleNamespace(subject=SUBJECT))
    monkeypatch.setattr(score, "generic_percent", lambda *_: 9.0)
    for name in ("ceiling", "oracle", "placebo"):
        monkeypatch.setattr(score, name, refuse if name == fails else lambda *_: None)
    if fails == "ceiling":
        monkeypatch.setattr(score, "_beside", lambda found, *_: found)
    given = Answer("strong", 0, "none", before=theta, after=theta)
    sitting = SimpleNamespace(effects=(), level=0.0)
    found = score.scored(Drawing("strong", 1, needs="all"), given, sitting)  # type: ignore[arg-type]
    assert found.ratio is not None and found.ratio > 0.8 and found.why == f"{fails}: gap_m is nan"


@pytest.mark.slow
def test_the_ceilings_of_two_effects_are_of_records_with_one_each(
    brief_rest: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The record without an effect is the same for both, and each effect changes something by itself."""
    asked: list[tuple[Record, Cause, Record]] = []

    def ideal(hidden: Record, before: Subject, cause: Cause, plain: Record, without: Subject) -> object:
        asked.append((hidden, cause, plain))
        return SimpleNamespace(of_answers={cause.mechanism: 0.123456, "none": 0.876544})

    monkeypatch.setattr(score, "_base_fit", lambda known: SimpleNamespace(subject=SUBJECT))
    monkeypatch.setattr(score, "ceiling", ideal)
    plan = Plan(counts=(1, 0, 0), seconds=(3.0, 0.0, 0.0), uses=("fit", "held"), recorded=False)
    (one,) = drawn(1, 4, "development", ("gain", "clock"), 2, 0.0, plan)
    found = score.scored(Drawing("two", 1, effects=2, needs="ceilings"), Answer("two", 0, "none"), one)
    assert [cause for _, cause, _ in asked] == list(found.causes) and len(found.causes) == 2
    assert [max(alone.values()) for alone in found.ceilings_alone] == [0.8765, 0.8765]
    both = record(one).cases
    assert len(both) == 2
    for hidden, _, plain in asked:
        for case, without, with_both in zip(hidden.cases, plain.cases, both, strict=True):
            changed = (case.measured_mps2 != without.measured_mps2).any(axis=0)
            assert changed.sum() == 1 and not np.array_equal(case.measured_mps2, with_both.measured_mps2)


def test_the_oracle_tries_every_law_of_the_true_class(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []
    monkeypatch.setattr(refits, "tries", lambda subject, effect, sites, cases: [(effect.name, tuple(sites))])
    monkeypatch.setattr(refits, "starts", lambda fit, cases, every: tried.extend(every) or [])
    monkeypatch.setattr(refits, "refitted", lambda *_: SimpleNamespace(subject=SUBJECT))
    oracle(SimpleNamespace(subject=SUBJECT), [], Cause("cubic", "neck", "joint"))  # type: ignore[arg-type]
    assert sorted(tried) == [("asymmetry", ("neck",)), ("cubic", ("neck",)), ("stop", ("neck",))]


def test_only_the_first_records_of_a_row_have_a_placebo(
    backrest: tuple[Record, Record], fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, hidden = backrest
    monkeypatch.setattr(score, "oracle", lambda *given: SUBJECT)
    monkeypatch.setattr(score, "placebo", lambda *given: SUBJECT)
    cause = Cause("backrest", "upper_torso", "backrest")
    last, after = (
        score._beside(Score("strong", number, (cause,)), Answer("strong", number, "none"), hidden, fit)
        for number in (score.PLACEBOS - 1, score.PLACEBOS)
    )
    assert last.placebo_percent == last.oracle_percent == after.oracle_percent and after.placebo_percent is None
