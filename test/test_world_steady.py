"""What makes a body of the world run away is made weaker, and never ends a draw."""

import numpy as np
import pytest
from world.effects import draw
from world.effects.moving import RUNAWAY_MPS2
from world.effects.sitting import Plan, drawn

PLAN = Plan(uses=("fit",), counts=(1, 1, 1))


@pytest.mark.parametrize("kind", ["reflex", "asymmetry"])
def test_an_effect_that_throws_a_body_out_is_drawn_weaker(kind: str) -> None:
    wild = draw.effect("development", np.random.default_rng(3), (kind,)).scaled(1e7)
    (found,) = drawn(1, 5, "development", (kind,), ratio=(1.0, 2.0), plan=PLAN, chosen=lambda number: wild)
    assert all(np.abs(accel).max() < RUNAWAY_MPS2 for accel in (*found.plain, *found.hidden))
    assert found.effects[0].strength < wild.strength
    assert found.ratio is None or np.isfinite(found.ratio)
