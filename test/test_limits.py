"""Limits files: the shipped one, deciding and additional sets, and refused content."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from expecting import refusal

from biodyn_core.base.errors import InputError
from biodyn_core.exposure.limits import EU_LIMITS, Limits, LimitSet, load_limits

SHIPPED = Path(__file__).parents[1] / "config" / "limits.yaml"
EU, ISO = EU_LIMITS.deciding, EU_LIMITS.additional[0]


def as_file(limits: LimitSet) -> dict[str, object]:
    """The values of a set in a file, without those it does not state."""
    return {name: value for name, value in limits.to_dict().items() if value is not None}


def test_the_shipped_limits_are_the_directive_and_the_papers_pair():
    assert load_limits(SHIPPED) == EU_LIMITS
    assert EU_LIMITS.deciding == LimitSet("2002/44/EC", 0.5, 9.1, 1.15, 21.0)
    assert EU_LIMITS.additional == (LimitSet("ISO 2631-1 caution zone", None, 8.5, None, 17.0),)


@pytest.fixture
def written(tmp_path):
    """Writes a limits file and hands back its path."""

    def write(content: object) -> Path:
        path = tmp_path / "mine.yaml"
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8")
        return path

    return write


@pytest.fixture
def refused(written):
    """Writes a limits file and hands back the one line it is refused with, file named."""

    def refuse(content: object) -> str:
        return refusal(load_limits, written(content))

    return refuse


def test_a_file_of_one_set_decides_by_itself(written):
    mine = LimitSet("the paper", 0.5, 8.5, 1.15, 17.0)
    assert load_limits(written(as_file(mine))) == Limits(mine)
    assert load_limits(written(as_file(ISO))) == Limits(ISO)


def test_a_file_of_several_sets_names_the_decisive_one(written):
    mine = LimitSet("works council", 0.4, None, 0.9, None)
    sets = [as_file(each) for each in (EU, mine, ISO)]
    assert load_limits(written({"decides": "works council", "sets": sets})) == Limits(mine, (EU, ISO))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"decides": "2002/44/EC"}, "missing, unknown or wrong: sets"),
        ({"sets": [as_file(EU)]}, "missing, unknown or wrong: decides"),
        ({"sets": [as_file(EU)], "decides": "2002/44/EC", "colour": "red"}, "missing, unknown or wrong: colour"),
        ({"sets": {"EU": as_file(EU)}, "decides": "2002/44/EC"}, "sets is not a list"),
        ({"sets": [], "decides": "2002/44/EC"}, "is empty"),
        (
            {"sets": [as_file(EU)], "decides": "ISO"},
            "decides is 'ISO', allowed are the sources of the sets: 2002/44/EC",
        ),
        ({"sets": [as_file(EU)], "decides": ["2002/44/EC"]}, "decides is ['2002/44/EC']"),
        ({"sets": [as_file(EU), as_file(EU)], "decides": "2002/44/EC"}, "'2002/44/EC' is there twice"),
        ({"sets": [as_file(EU), 7], "decides": "2002/44/EC"}, "sets[1]: source is needed"),
        ({"sets": [as_file(EU), {"source": "x"}], "decides": "2002/44/EC"}, "sets[1]: no value, give"),
    ],
)
def test_invalid_sets_are_refused(refused, content, message):
    assert message in refused(content)


@pytest.mark.parametrize("key", ["action_a8_mps2", "action_vdv_mps175", "limit_a8_mps2", "limit_vdv_mps175"])
def test_half_a_pair_and_a_key_too_many_are_refused(refused, key):
    limits = EU.to_dict()
    del limits[key]
    message = refused(limits)
    assert key in message and "belong together" in message
    assert "unknown: action_a8" in refused({**EU.to_dict(), "action_a8": 0.5})


@pytest.mark.parametrize("source", [None, "", "  ", 2631, ["a"]])
def test_a_set_needs_a_source(refused, source):
    assert "source is " in refused({**EU.to_dict(), "source": source})


@pytest.mark.parametrize("key", ["action_a8_mps2", "action_vdv_mps175", "limit_a8_mps2", "limit_vdv_mps175"])
@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "0.5", True, None, [0.5], 10**400])
def test_a_value_that_is_not_positive_is_named(refused, key, value):
    assert f"{key} is " in refused({**EU.to_dict(), key: value})


@pytest.mark.parametrize("text", ["", "- 1\n", "5\n", "action_a8_mps2: 0.5\n"])
def test_a_file_that_holds_something_else_is_refused(refused, text):
    assert "source is needed" in refused(text)


@pytest.mark.parametrize("text", ["a: [1\n", "source: 2024-13-45\n", "a: \x00\n"])
def test_a_file_that_is_no_yaml_is_refused(refused, text):
    assert "not a YAML file" in refused(text)


def test_a_value_given_twice_is_refused(refused):
    assert "limit_a8_mps2: given twice" in refused(yaml.safe_dump(EU.to_dict()) + "limit_a8_mps2: 5.0\n")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.yaml: cannot be read"):
        load_limits(tmp_path / "none.yaml")


@pytest.mark.parametrize("measure", ["a8_mps2", "vdv_mps175"])
def test_a_limit_below_its_action_value_is_refused_by_name(refused, measure):
    message = refused({**EU.to_dict(), f"limit_{measure}": 0.3})
    assert f"limit_{measure} lies below action_{measure}" in message
