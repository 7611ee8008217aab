"""Experiments that separate effects, and lists of missing recordings."""

import dataclasses
import json

import pytest

from biodyn_core.effects import CATALOGUE, Effect
from biodyn_core.tracing import louder, results
from biodyn_core.tracing.data_checks import FloorSettings
from biodyn_core.tracing.experiments import BARE, LEVELS, REPEAT, SHOCKS, SWAP, TAP, TURNS, separating, to_record
from biodyn_core.tracing.findings import LouderRecordings, Need
from biodyn_core.tracing.settings import TraceSettings


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ((), REPEAT),
        (("stop",), REPEAT),
        (("stop", "stop"), REPEAT),  # at two sites
        (("stop", "cubic"), SHOCKS),
        (("clock", "skin"), TAP),
        (("clock", "relaxation"), SWAP),
        (("tilt", "cross_axis"), SWAP),
        (("tilt", "gain"), f"{TAP}; and {TURNS}"),
        (("viscera", "friction"), LEVELS),
        (("harness", "stop"), f"{BARE}; and {SHOCKS}"),
        (("harness", "stop", "friction"), f"{BARE}; and {SHOCKS}"),  # two are enough to ask for
    ],
)
def test_rivals_are_separated_by_an_experiment(names: tuple[str, ...], expected: str) -> None:
    assert separating([CATALOGUE[name] for name in names]) == expected


BY_LEVELS = ("relaxation", "viscera", "reflex", "quadratic_damping", "friction", "hysteresis", "cushion")
BY_OTHERS = (
    "added_mass", "asymmetry", "backrest", "bending", "clock", "cross_axis", "cubic", "gain", "harness", "lift_off",
    "periodic", "pitch", "posture", "skin", "stop", "thixotropy", "tilt",
)  # fmt: skip


@pytest.mark.parametrize("name", [*BY_LEVELS, *BY_OTHERS])
def test_two_effects_of_one_family_are_separated_by_its_experiment(name: str) -> None:
    pair = (CATALOGUE[name], dataclasses.replace(CATALOGUE[name], name="other"))
    assert (separating(pair) == LEVELS) == (name in BY_LEVELS)


def test_two_levels_of_one_road_are_the_default_of_effects_that_declare_none() -> None:
    silent = [dataclasses.replace(CATALOGUE[name], separated_by=Effect.separated_by) for name in ("stop", "cubic")]
    assert separating(silent) == LEVELS


@pytest.mark.parametrize(
    ("need", "expected"),
    [
        (("held out", 9.0, 2, 1), "9 s more road, 2 more shocks of 0.8 g, one of them of 2 g, held out"),
        (("held out", 8.2, 0, 0), "9 s more road, held out"),
        (("to fit", 0.0, 1, 0), "1 more shock of 0.8 g, to fit"),
        (("to fit", 0.0, 1, 1), "1 more shock of 2 g, to fit"),
        (("to fit", 0.0, 4, 2), "4 more shocks of 0.8 g, 2 of them of 2 g, to fit"),
        (("to fit", 3.0, 0, 0, ("another loading condition than road",)),
         "3 s more road, to fit, in another loading condition than road"),
        (("held out", 0.0, 0, 0, ("a further recording of rail",)), "a further recording of rail, held out"),
    ],
)  # fmt: skip
def test_missing_recordings_are_one_list(need: tuple, expected: str) -> None:
    assert to_record([Need(*need)], FloorSettings()) == expected
    twice = to_record([Need("to fit", 5.0, 0, 0), Need(*need)], FloorSettings())
    assert twice == f"5 s more road, to fit; {expected}"


# --- louder motion ---------------------------------------------------------------------------------------------------

LOUDER = [
    LouderRecordings("bending", 1.5, 4, 0, 0, 3, 3),
    LouderRecordings("dry_friction", 1.5, 6, 0, 1, 2, 2),
    LouderRecordings("nonlinear_stiffness", 1.5, 8, 2, 2, 3, 6),
]


def test_louder_motion_is_stored_and_asked_for_where_it_lifts_a_possible_mechanism(monkeypatch) -> None:
    text = louder.louder_text(LOUDER, 1.5, {"run": 7})
    assert louder.louder_from(text) == tuple(LOUDER) and json.loads(text)["provenance"] == {"run": 7}
    monkeypatch.setattr(louder, "_stored", lambda: louder.louder_from(text))
    assert louder.louder_recordings(["none", "bending"]) == ()
    assert louder.louder_recordings(["nonlinear_stiffness", "dry_friction"]) == tuple(LOUDER[1:])


def test_louder_motion_is_stated_for_the_probability_that_it_was_counted_for() -> None:
    likely = tuple(one.mechanism for one in louder._stored())
    assert results._louder(likely, TraceSettings()) == louder.louder_recordings(likely) != ()
    assert results._louder(likely, TraceSettings(named_from=0.7)) == ()


def test_the_packaged_counts_are_possible() -> None:
    found = louder._stored()
    assert len(found) > 5 and {one.mechanism for one in found} <= {effect.mechanism for effect in CATALOGUE.values()}
    for one in found:
        counts = (one.named, one.named_louder, one.with_true_law, one.with_true_law_louder)
        assert one.level > 1.0 and min(counts) >= 0 and max(counts) <= one.effects
