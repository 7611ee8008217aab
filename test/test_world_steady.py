"""Strengths that make a simulated body unstable are replaced and never end a draw."""

import dataclasses

import numpy as np
import pytest
from world.effects import absorbing, draw, sitting
from world.effects.moving import RUNAWAY_MPS2
from world.effects.sitting import Plan, drawn

PLAN = Plan(uses=("fit",), counts=(1, 0, 0), seconds=(1.2, 1.2, 1.2))


@pytest.mark.slow
def test_effects_that_destabilise_a_body_are_drawn_weaker() -> None:
    rng = np.random.default_rng(3)
    wild = [draw.effect("development", rng, (kind,)).scaled(1e7) for kind in ("reflex", "asymmetry")]
    for found, thrown in zip(drawn(2, 5, ratio=(1.0, 2.0), plan=PLAN, chosen=wild.__getitem__), wild, strict=True):
        assert all(np.abs(accel).max() < RUNAWAY_MPS2 for accel in (*found.plain, *found.hidden))
        assert found.effects[0].strength < thrown.strength
        assert found.ratio is None or np.isfinite(found.ratio)


CALM_FROM = 1.0
"""Strength below which the law of the next tests diverges: its stiffness is inverse to its strength."""


@dataclasses.dataclass(frozen=True)
class Law:
    """A law of some strength."""

    strength: float
    scalable: bool = True
    strengths: tuple[float, float] = (1.0, 10.0)

    def scaled(self, factor: float) -> "Law":
        """The same, stronger or weaker."""
        return dataclasses.replace(self, strength=self.strength * factor)


@dataclasses.dataclass(frozen=True)
class Sat:
    """A sitting with the attributes needed here alone."""

    effects: tuple[Law, ...]
    ratio: float | None = None
    hidden: tuple[np.ndarray, ...] = (np.array([np.nan]),)


def stiff(one: Sat) -> bool:
    return one.effects[0].strength < CALM_FROM


class Seen:
    """Ratios as large as the strength, infinite where the law is too stiff."""

    def __init__(self, sittings: list[Sat]) -> None:
        pass

    def ratios(self, sittings: list[Sat]) -> list[float]:
        """As in the class."""
        return [np.inf if stiff(one) else one.effects[0].strength for one in sittings]


def test_an_unstable_strength_is_reduced_to_the_last_stable_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(absorbing, "_Seen", Seen)
    stays, moves = absorbing.scaled([Sat((Law(2.0),)), Sat((Law(2.0),))], [0.5, 4.0])
    assert (stays.effects[0].strength, stays.ratio) == (2.0, 2.0)
    assert (moves.effects[0].strength, moves.ratio) == (4.0, 4.0)


def test_without_a_stable_weaker_strength_a_stronger_one_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    def with_effects(sittings: list[Sat]) -> list[Sat]:
        return [one if stiff(one) else dataclasses.replace(one, hidden=(np.zeros(1),)) for one in sittings]

    monkeypatch.setattr(sitting, "with_effects", with_effects)
    (found,) = sitting.steady([Sat((Law(0.3),))])
    assert found.effects[0].strength == pytest.approx(1.2) and found.hidden[0][0] == 0.0
