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


def test_every_family_has_one_and_a_new_one_is_not_left_without() -> None:
    stop = CATALOGUE["stop"]
    for effect in CATALOGUE.values():
        beside = dataclasses.replace(effect, name="beside")
        assert separating([effect, beside])
    strangers = [dataclasses.replace(stop, name=name, family="unheard_of") for name in ("one", "other")]
    assert separating(strangers) == LEVELS
