"""A glance at the catalogue can be kept, and comes back as it was."""

import json
from functools import cache

import hiding
import numpy as np
import pytest

from biodyn_core.errors import InputError
from biodyn_core.tracing.glance import Glance, glance, plain, taken_up
from biodyn_core.tracing.screen import Tried, candidates


def tried() -> list[Tried]:
    return [one for one in candidates(hiding.events(6))[0] if one.applied.effect.name in ("gain", "lift_off")]


@cache
def found() -> Glance:
    return glance(hiding.background(hiding.louder, hiding.plain), tried(), 30, 0, lambda stage, share: None)


def test_what_is_hidden_is_in_the_running_and_so_is_lift_off() -> None:
    names = [(one.applied.effect.name, one.applied.site) for one in found().running(1)]
    assert names[0] == ("gain", "neck") and ("lift_off", "pelvis") in names
    assert len(names) == len(set(names))


def test_it_comes_back_from_json_as_it_was() -> None:
    again = taken_up(json.loads(json.dumps(plain(found()))), tried())
    assert [one.gain for one in again.found] == [one.gain for one in found().found]
    assert [dict(one.applied.values) for one in again.found] == [dict(one.applied.values) for one in found().found]
    assert [one.tried.name for one in again.screening.ladder] == [one.tried.name for one in found().screening.ladder]
    np.testing.assert_array_equal(again.screening.chance, found().screening.chance)
    one, other = again.screening.tried[0], again.screening.tried[1]
    assert again.screening.cosine(one, other) == pytest.approx(
        found().screening.cosine(*found().screening.tried[:2]), abs=1e-4
    )


@pytest.mark.parametrize(
    "damage",
    [
        {"ladder": [[999, 0.0, 0.0, 0.0, 1.0]]},
        {"chance": []},
        {"chance": ["x"]},
        {"along": [[1.0]]},
        {"found": [[0, 0.0, 0.0, {"nonsense": 1.0}]]},
        {"found": 3},
    ],
)
def test_a_damaged_one_is_refused(damage: dict) -> None:
    with pytest.raises(InputError):
        taken_up(plain(found()) | damage, tried())


def test_one_of_other_candidates_is_refused() -> None:
    with pytest.raises(InputError):
        taken_up(plain(found()), tried()[:3])
