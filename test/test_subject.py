"""Subject files: written and read back, faults with file and key, the shipped ones equal the paper's."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
import yaml
from expecting import refusal
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import THETAS, printed, shipped
from provenances import with_spread

from biodyn_core import body
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS, STIFFENING_SHAPE_PER_M
from biodyn_core.body.model import Chain
from biodyn_core.body.origin import origin_of
from biodyn_core.body.parameter_spread import parameter_spread
from biodyn_core.body.parameters import Parameters
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.usual_residual import usual_residuals
from biodyn_ros.base.resources import subject_file

SHIPPED = Path(__file__).parents[1] / "config" / "subjects"
SUBJECTS = st.builds(
    Subject,
    name=st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Zl", "Zp"]), min_size=1).filter(str.strip),
    body_mass_kg=st.floats(30.0, 200.0),
    stature_m=st.floats(1.2, 2.3),
    mass_matrix=st.sampled_from(["segment", "cascade"]),
    parameters=st.builds(Parameters.from_vector, THETAS),
    provenance=st.dictionaries(st.text("abc_", min_size=1), st.one_of(st.integers(), st.text("xyz: #'\n"), st.none())),
)
GOOD = {
    "schema": 1,
    "name": "someone",
    "body_mass_kg": 70,
    "stature_m": 1.75,
    "mass_matrix": "segment",
    "parameters": {
        "natural_frequency_hz": [10.0, 10.0, 10.0, 10.0, 10.0, 10.0],
        "damping_ratio": [0.2, 0.2, 0.2, 0.2, 0.2, 0.2],
        "rayleigh_rad_per_s": 1,
        "stiffening_scale": 0.3,
        "mass_scale": 1,
    },
}


@pytest.fixture
def refused(tmp_path):
    """Writes a subject file and hands back the one line it is refused with, file named."""

    def refuse(content: object) -> str:
        path = tmp_path / "somebody.yaml"
        text = content if isinstance(content, str) else yaml.safe_dump(content)
        path.write_text(text, encoding="utf-8")
        return refusal(load_subject, path)

    return refuse


def changed(key: str, value: object, inner: str | None = None) -> dict:
    """The good file with one value replaced, or one of its parameters."""
    data = copy.deepcopy(GOOD)
    if inner is None:
        data[key] = value
    else:
        data[key][inner] = value
    return data


# --- round trips -----------------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(SUBJECTS)
def test_a_written_subject_is_read_back(tmp_path_factory, subject):
    path = tmp_path_factory.mktemp("subject") / "s.yaml"
    path.write_text(subject.to_yaml(), encoding="utf-8")
    back = load_subject(path)
    assert back == subject
    assert back.to_yaml() == subject.to_yaml()


@settings(max_examples=25)
@given(SUBJECTS)
def test_the_mapping_is_read_back(subject):
    assert Subject.from_dict(subject.to_dict()) == subject


def test_whole_numbers_are_accepted_for_real_ones():
    subject = Subject.from_dict(GOOD)
    assert isinstance(subject.body_mass_kg, float) and subject.parameters.mass_scale == 1.0


def test_an_empty_list_of_effects_is_allowed_and_provenance_kept():
    subject = Subject.from_dict({**GOOD, "effects": [], "provenance": {"bags": ["a"]}})
    assert subject.provenance == {"bags": ["a"]}


# --- the shipped files -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize(("suffix", "form"), [("", "segment"), ("_as_printed", "cascade")])
def test_the_shipped_subjects_are_tables_4_and_5(number, suffix, form):
    subject = shipped(f"subject_{number}{suffix}")
    rows = printed("tables_4_5.csv", subject=str(number))
    foot = printed("tables_4_5_totals.csv")[number - 1]
    assert [row["joint"] for row in rows] == list(SEGMENTS)
    assert subject.mass_matrix == form
    assert (subject.body_mass_kg, subject.stature_m) == (float(foot["body_mass_kg"]), float(foot["stature_m"]))
    p = subject.parameters
    assert p.natural_frequency_hz.tolist() == [float(row["f_n_hz"]) for row in rows]
    assert p.damping_ratio.tolist() == [float(row["zeta"]) for row in rows]
    assert [p.rayleigh_rad_per_s, p.stiffening_scale, p.mass_scale] == [
        float(foot[name]) for name in ("alpha_r_rad_per_s", "s_nl", "m_scale")
    ]
    # s_nl is printed with three digits, which is 0.23 % of 0.217.
    alpha = [float(row["alpha_nl_per_m"]) for row in rows]
    np.testing.assert_allclose(p.stiffening_scale * STIFFENING_SHAPE_PER_M, alpha, rtol=2.5e-3)


def test_no_other_subject_is_shipped_untested():
    assert {path.name for path in SHIPPED.iterdir()} == {
        f"subject_{number}{suffix}.yaml" for number in (1, 2) for suffix in ("", "_as_printed")
    }


# --- refusals --------------------------------------------------------------------------------------------------------


def test_the_valid_file_is_accepted(tmp_path):
    path = tmp_path / "good.yaml"
    path.write_text(yaml.safe_dump(GOOD), encoding="utf-8")
    assert load_subject(path).name == "someone"


@pytest.mark.parametrize("key", sorted(GOOD))
def test_a_missing_key_is_named(refused, key):
    message = refused({name: value for name, value in GOOD.items() if name != key})
    assert f"key '{key}' is missing" in message


def test_a_missing_mass_matrix_is_reported_with_the_choices(refused):
    message = refused({name: value for name, value in GOOD.items() if name != "mass_matrix"})
    assert "segment and cascade" in message and "no default" in message


@pytest.mark.parametrize("key", sorted(GOOD["parameters"]))
def test_a_missing_parameter_is_named(refused, key):
    data = changed("name", "someone")
    del data["parameters"][key]
    message = refused(data)
    assert "parameters" in message and f"'{key}' is missing" in message


def test_an_unknown_key_is_named(refused):
    assert "unknown key 'body_weight_kg'" in refused(changed("body_weight_kg", 70))
    assert "parameters: unknown key 'zeta'" in refused(changed("parameters", 1, "zeta"))
    assert "unknown key 7" in refused(changed(7, 70))


def test_a_key_given_twice_is_named(refused):
    text = yaml.safe_dump(GOOD)
    assert "name: given twice" in refused(text + "name: another\n")
    assert "mass_scale: given twice" in refused(text.replace("  mass_scale: 1", "  mass_scale: 1\n  mass_scale: 1.1"))


@pytest.mark.parametrize("group", ["natural_frequency_hz", "damping_ratio"])
@pytest.mark.parametrize("size", [0, 5, 7])
def test_a_list_of_another_length_is_named(refused, group, size):
    message = refused(changed("parameters", [0.3] * size, group))
    assert f"parameters.{group}: 6 values" in message and f"got {size}" in message


@pytest.mark.parametrize(
    ("key", "inner", "value", "name"),
    [
        ("body_mass_kg", None, 29.9, "body_mass_kg is 29.9"),
        ("body_mass_kg", None, 201, "body_mass_kg is 201"),
        ("stature_m", None, 1.1, "stature_m is 1.1"),
        ("stature_m", None, 175, "stature_m is 175"),
        (
            "parameters",
            "natural_frequency_hz",
            [10.0, 10.0, 10.0, 10.0, 25.0, 10.0],
            "natural_frequency_hz[neck] is 25",
        ),
        ("parameters", "damping_ratio", [0.0, 0.2, 0.2, 0.2, 0.2, 0.2], "damping_ratio[pelvis] is 0"),
        ("parameters", "rayleigh_rad_per_s", 3.01, "rayleigh_rad_per_s is 3.01 rad/s"),
        ("parameters", "stiffening_scale", -0.1, "stiffening_scale is -0.1"),
        ("parameters", "mass_scale", 1.2, "mass_scale is 1.2"),
    ],
)
def test_a_value_out_of_range_is_named_with_the_allowed_range(refused, key, inner, value, name):
    message = refused(changed(key, value, inner))
    assert name in message and "allowed are" in message


@pytest.mark.parametrize("key", ["body_mass_kg", "stature_m"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), "70", True, None, [70], 10**400])
def test_a_value_that_is_no_number_is_named(refused, key, value):
    assert f"{key} is " in refused(changed(key, value))


@pytest.mark.parametrize("key", ["rayleigh_rad_per_s", "stiffening_scale", "mass_scale"])
@pytest.mark.parametrize("value", [float("nan"), float("-inf"), "1", False, None, {}, 10**400])
def test_a_parameter_that_is_no_number_is_named(refused, key, value):
    assert f"parameters.{key} is " in refused(changed("parameters", value, key))


@pytest.mark.parametrize("value", [float("nan"), "0.2", True, None, [0.2]])
def test_an_item_of_a_list_that_is_no_number_is_named_with_its_place(refused, value):
    message = refused(changed("parameters", [0.2, 0.2, value, 0.2, 0.2, 0.2], "damping_ratio"))
    assert "parameters.damping_ratio[2] is " in message


@pytest.mark.parametrize("value", [0.2, "0.2 0.2", {"pelvis": 0.2}, None])
def test_a_value_that_is_no_list_is_named(refused, value):
    assert "parameters.damping_ratio is " in refused(changed("parameters", value, "damping_ratio"))


@pytest.mark.parametrize("value", ["Segment", "", None, 1, ["segment"], {"segment": 1}])
def test_another_mass_matrix_is_refused(refused, value):
    assert "mass_matrix is " in refused(changed("mass_matrix", value))


@pytest.mark.parametrize("value", [0, -1, 1.0, "1", True, None])
def test_a_schema_that_is_no_whole_number_from_one_is_refused(refused, value):
    assert "schema is " in refused(changed("schema", value))


def test_a_newer_schema_is_refused_with_advice(refused):
    message = refused(changed("schema", 2))
    assert "schema 2 is newer" in message and "update" in message


def test_a_name_may_be_a_block_of_one_line() -> None:
    assert Subject.from_dict(changed("name", "anna\n")).name == "anna"


@pytest.mark.parametrize("value", ["", "  ", 7, None, ["a"], "a\nb", "a\u2028b", "a\x1b[31m"])
def test_a_name_that_is_no_text_is_refused(refused, value):
    assert "name is " in refused(changed("name", value))


@pytest.mark.parametrize("value", ["a text", [1], 5])
def test_provenance_that_is_no_mapping_is_named(refused, value):
    assert "provenance: " in refused(changed("provenance", value))


@pytest.mark.parametrize("text", ["", "- 1\n", "just a word\n", "5\n"])
def test_a_file_that_holds_something_else_is_refused(refused, text):
    assert "expected keys and values" in refused(text)


@pytest.mark.parametrize(
    "text",
    [
        "a: [1, 2\n",
        "a: b: c\n",
        "\tname: x\n",
        "a: \x00\n",
        "name: !!python/object/apply:os.getcwd []\n",
        "a: 1\n---\nb: 2\n",
        "name: 2024-13-45\n",
        "name: 0b_\n",
        "name: !!float abc\n",
        "? [1, 2]\n: 3\n",
        "[" * 5000,
    ],
)
def test_a_file_that_is_no_yaml_is_refused(refused, text):
    assert "not a YAML file" in refused(text)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match=r"binary\.yaml: not a YAML file"):
        load_subject(path)


def test_a_missing_file_and_a_folder_are_refused_by_name(tmp_path):
    with pytest.raises(InputError, match=r"nobody\.yaml: cannot be read"):
        load_subject(tmp_path / "nobody.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        load_subject(tmp_path)


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("noise") / "noise.yaml"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    with pytest.raises(InputError, match="noise"):
        load_subject(path)


def test_the_public_names_of_a_body_load_on_first_use() -> None:
    found = body.Chain.of(body.load_subject(subject_file("subject_1")))
    assert isinstance(found, Chain) and body.Subject is Subject
    with pytest.raises(AttributeError, match="has no attribute 'Chains'"):
        body.Chains  # noqa: B018 - the access is the test


# --- changed by hand -------------------------------------------------------------------------------------------------

EDITS = {
    "mass": {"body_mass_kg": 80.0},
    "mass matrix": {"mass_matrix": "cascade"},
    "a parameter": {"parameters": GOOD["parameters"] | {"mass_scale": 0.9}},
    "an effect": {"effects": [{"name": "gain", "site": "head", "parameters": {"gain": 0.1}}]},
}


def fitted_file() -> dict[str, object]:
    """The mapping of a fitted subject's file, as YAML reads it."""
    return yaml.safe_load(with_spread(Subject.from_dict(GOOD)).to_yaml())


@pytest.mark.parametrize("edit", EDITS.values(), ids=EDITS)
def test_errors_of_a_fit_do_not_hold_for_a_model_that_was_changed_by_hand(edit: dict[str, object]) -> None:
    edited = Subject.from_dict(fitted_file() | edit)
    spread, why_no_spread = parameter_spread(edited.provenance)
    laws, why_no_laws = usual_residuals(edited.provenance)
    assert (spread, laws, origin_of(edited)) == (None, {}, "edited")
    assert "changed by hand" in why_no_spread and why_no_laws == why_no_spread


def test_a_subject_that_was_changed_by_hand_stays_so_when_it_is_written_again() -> None:
    edited = Subject.from_dict(fitted_file() | EDITS["mass"])
    again = Subject.from_dict(yaml.safe_load(edited.to_yaml()))
    assert again == edited and origin_of(again) == "edited"


def test_name_stature_and_whole_numbers_change_no_model() -> None:
    same = Subject.from_dict(fitted_file() | {"name": "another", "stature_m": 1.8, "body_mass_kg": 70})
    assert parameter_spread(same.provenance)[0] is not None and usual_residuals(same.provenance)[0]


def test_a_file_without_a_digest_is_read_as_it_is() -> None:
    content = fitted_file() | EDITS["mass"]
    del content["provenance"]["model_digest"]  # type: ignore[index]
    assert parameter_spread(Subject.from_dict(content).provenance)[0] is not None


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.yaml")), ids=lambda path: path.stem)
def test_a_bundled_subject_is_the_papers_until_it_is_changed(path: Path) -> None:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert origin_of(Subject.from_dict(content)) == "paper"
    assert origin_of(Subject.from_dict(content | {"body_mass_kg": 99.0})) == "edited"
