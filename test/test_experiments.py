"""What to record next depends on what is to be told apart."""

import dataclasses

import pytest

from biodyn_core.effects import CATALOGUE
from biodyn_core.tracing.experiments import BARE, LEVELS, REPEAT, SHOCKS, SWAP, TAP, TURNS, separating


@pytest.mark.parametrize(
    ("names", "said"),
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
def test_experiments_that_separate(names: tuple[str, ...], said: str) -> None:
    assert separating([CATALOGUE[name] for name in names]) == said


def test_every_family_has_its_own_and_a_new_one_is_not_left_without() -> None:
    """Two levels of one road are asked for where the law itself is in question, and where nothing else is known."""
    pairs = {effect.name: (effect, dataclasses.replace(effect, name="beside")) for effect in CATALOGUE.values()}
    assert {name for name, pair in pairs.items() if separating(pair) == LEVELS} == {
        "relaxation", "viscera", "reflex", "quadratic_damping", "friction", "hysteresis", "cushion",
    }  # fmt: skip
    strangers = [dataclasses.replace(effect, family="unheard_of") for effect in pairs["stop"]]
    assert separating(strangers) == LEVELS
