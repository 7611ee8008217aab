"""Own laws of a background: the body without the one that an answer names, and its ratio."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from outcomes import CLOCK, SKIN, outcome
from world.effects import background, sitting
from world.effects.sitting import Plan, Sitting

from biodyn_core.base.segments import SEGMENTS
from blind.tracing.outcome import LEAST_RATIO, Answer, Cause
from blind.tracing.own_laws import without_law
from blind.tracing.rows import DRAWINGS, STRONG
from blind.tracing.score import own_ratio, scored
from blind.tracing.sections import own_law_lines

SHORT = Plan(counts=(1, 0, 0), seconds=(0.3, 0.3, 0.3), uses=("fit",), recorded=False)
BACKGROUND = next(one for one in DRAWINGS if one.name == "background")
FIELDS = [field.name for field in dataclasses.fields(background.Background)]
NAMED = {
    ("asymmetry", "pelvis"): {"bent": 0, "cubic": 0},
    ("quadratic_damping", "head"): {"squared": 5},
    ("friction", "upper_torso"): {"friction_n": 3},
    ("gain", "head"): {"gain": 6},
    ("clock", "pelvis"): {"late_s": 1},
    ("tilt", "neck"): {"lean_rad": 5},
    ("skin", "lower_torso"): {"skin_hz": 2},
}


@cache
def body(level: float = 1.0) -> Sitting:
    """A body with a background of the paper's kind, and nothing hidden; without rest, of which nothing is asked."""
    (one,) = sitting.drawn(1, 3, effects=0, level=level, plan=SHORT)
    return one


def cause(name: str, site: str) -> Cause:
    return Cause(name, site, "")


@pytest.mark.parametrize("named", NAMED, ids=" at ".join)
def test_the_named_law_alone_is_absent(named: tuple[str, str], no_rest: None) -> None:
    less, changed = without_law(body(), cause(*named)), NAMED[named]
    assert less is not None
    for field in FIELDS:
        before, after = (getattr(one.background, field) for one in (body(), less))
        if field in changed:
            at = changed[field]
            np.testing.assert_array_equal(after[at], getattr(background.NOTHING, field)[at])
            before, after = (np.delete(values, at, axis=0) for values in (before, after))
        np.testing.assert_array_equal(after, before)
    moves = bool({"bent", "squared", "friction_n"} & set(changed))
    assert np.array_equal(less.plain[0], body().plain[0]) is not moves


@pytest.mark.parametrize(("name", "site"), [("relaxation", "head"), ("pitch", "seat"), ("gain", "")])
def test_a_background_without_such_a_law_has_none(name: str, site: str, no_rest: None) -> None:
    assert without_law(body(), cause(name, site)) is None


@pytest.mark.parametrize("named", NAMED, ids=" at ".join)
def test_a_body_without_a_background_has_no_law(named: tuple[str, str], no_rest: None) -> None:
    assert without_law(body(0.0), cause(*named)) is None


def test_only_a_named_cause_has_an_own_law(no_rest: None) -> None:
    for verdict, effects in (
        ("none", ()),
        ("ambiguous", (cause("gain", "head"),)),
        ("effect", (cause("pitch", "seat"),)),
    ):
        assert scored(BACKGROUND, Answer("background", 0, verdict, effects), body()).own_ratio is None


@pytest.mark.slow
def test_the_ratio_of_a_strong_own_law_is_large_and_that_of_a_weak_one_small() -> None:
    """The head's joint bends by 30 % and that of the neck by 3 %, with the rest of a weak background around both."""
    plan = Plan(counts=(1, 1, 1), seconds=(4.0, 3.0, 3.0), uses=("fit", "held"), recorded=False)
    (draft,) = sitting.drawn(1, 3, effects=0, level=0.4, plan=plan)
    bent = np.zeros(6)
    bent[SEGMENTS.index("head")], bent[SEGMENTS.index("neck")] = 0.6, 0.03
    calm = dataclasses.replace(draft.background, bent=bent, cubic=np.zeros(6))
    (one,) = sitting.together([dataclasses.replace(draft, background=calm)])
    strong, weak = (
        own_ratio(BACKGROUND, Answer("background", 0, "effect", (cause("asymmetry", site),)), one)
        for site in ("head", "neck")
    )
    assert strong is not None and weak is not None
    assert strong > STRONG and weak < LEAST_RATIO


def test_the_page_lists_causes_named_where_nothing_is_hidden() -> None:
    found = [
        outcome("background", "effect", [SKIN], number=7, p=0.91, own_ratio=1.234),
        outcome("nothing", "effect", [CLOCK], number=2, p=0.85),
        outcome("background", "none"),
        outcome("strong", "effect", [SKIN], [SKIN], ratio=2.0),
    ]
    rows = [line for line in own_law_lines(found) if line.startswith("| ")][1:]
    assert [row.strip("| ").split(" | ") for row in rows if "---" not in row] == [
        ["background 7", "skin at head", "0.91", "1.23"],
        ["nothing 2", "clock at head", "0.85", "-"],
    ]
    assert own_law_lines(found[2:]) == []
