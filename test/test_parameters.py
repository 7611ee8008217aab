"""The fifteen parameters: Table 1 as printed, maps of the search, and refusals that name the fault."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from paper import SHARES, printed

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEGMENTS
from biodyn_core.body.parameters import LOWER, PARAMETERS, UPPER, Parameters, from_log, from_sigmoid, to_log, to_sigmoid

ULPS = 8 * np.finfo(float).eps


def printed_bounds() -> np.ndarray:
    """Table 1 spread over theta, (15, 2)."""
    rows = {row["variable"]: (float(row["lower"]), float(row["upper"])) for row in printed("table_1.csv")}
    return np.array(
        [
            *(rows[f"f_n{i}"] for i in range(1, 7)),
            *[rows["zeta"]] * 6,
            *(rows[name] for name in ("alpha_r", "s_nl", "m_scale")),
        ]
    )


def inside(shares: np.ndarray) -> np.ndarray:
    """Theta at shares of the way from the lower to the upper bound of Table 1."""
    lower, upper = printed_bounds().T
    return np.clip(lower + shares * (upper - lower), lower, upper)


def test_the_bounds_are_those_of_table_1():
    np.testing.assert_array_equal(np.column_stack([LOWER, UPPER]), printed_bounds())


def test_theta_has_the_order_of_equation_28():
    groups = [p.group for p in PARAMETERS]
    assert groups[:12] == ["natural_frequency_hz"] * 6 + ["damping_ratio"] * 6
    assert groups[12:] == ["rayleigh_rad_per_s", "stiffening_scale", "mass_scale"]
    assert [p.segment for p in PARAMETERS] == [*SEGMENTS, *SEGMENTS, None, None, None]


@given(SHARES)
def test_a_vector_is_recovered_from_its_names(shares):
    theta = inside(shares)
    p = Parameters.from_vector(theta)
    np.testing.assert_array_equal(p.vector(), theta)
    np.testing.assert_array_equal(p.damping_ratio, theta[6:12])
    assert (p.rayleigh_rad_per_s, p.stiffening_scale, p.mass_scale) == tuple(theta[12:])
    assert p == Parameters.from_vector(theta) and hash(p) == hash(Parameters.from_vector(theta))


def test_every_bound_itself_is_allowed():
    for row in printed_bounds().T:
        np.testing.assert_array_equal(Parameters.from_vector(row).vector(), row)


@pytest.mark.parametrize("index", range(15))
@pytest.mark.parametrize("side", [0, 1])
def test_a_value_just_outside_its_bound_is_refused_by_name(index, side):
    theta = printed_bounds().mean(axis=1)
    theta[index] = np.nextafter(printed_bounds()[index, side], [-np.inf, np.inf][side])
    with pytest.raises(InputError, match=r"parameters: ") as error:
        Parameters.from_vector(theta)
    assert PARAMETERS[index].name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("index", range(15))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused_by_name(index, value):
    theta = printed_bounds().mean(axis=1)
    theta[index] = value
    with pytest.raises(InputError) as error:
        Parameters.from_vector(theta)
    assert PARAMETERS[index].name in str(error.value)


def test_zero_is_allowed_for_stiffening_alone():
    for index in range(15):
        theta = printed_bounds().mean(axis=1)
        theta[index] = 0.0
        if PARAMETERS[index].group == "stiffening_scale":
            assert Parameters.from_vector(theta).stiffening_scale == 0.0
        else:
            with pytest.raises(InputError):
                Parameters.from_vector(theta)


def test_equal_parameters_have_equal_hashes_for_either_sign_of_zero():
    theta = printed_bounds().mean(axis=1)
    pair = []
    for zero in (0.0, -0.0):
        theta[13] = zero
        pair.append(Parameters.from_vector(theta))
    assert pair[0] == pair[1] and hash(pair[0]) == hash(pair[1])


@pytest.mark.parametrize("size", [0, 14, 16])
def test_a_theta_of_another_length_is_refused(size):
    with pytest.raises(InputError, match="15 values"):
        Parameters.from_vector(np.ones(size))


@pytest.mark.parametrize("group", ["natural_frequency_hz", "damping_ratio"])
@pytest.mark.parametrize("size", [0, 5, 7])
def test_a_joint_list_of_another_length_is_refused_by_name(group, size):
    theta = printed_bounds().mean(axis=1)
    joints = {"natural_frequency_hz": theta[:6], "damping_ratio": theta[6:12], group: np.ones(size)}
    with pytest.raises(InputError, match=f"parameters.{group}: 6 values .* got {size}"):
        Parameters(**joints, rayleigh_rad_per_s=1.0, stiffening_scale=0.0, mass_scale=1.0)


def test_parameters_cannot_be_changed_from_outside():
    source = printed_bounds().mean(axis=1)
    p = Parameters.from_vector(source)
    source[0] = -1.0
    assert p.natural_frequency_hz[0] > 0.0
    with pytest.raises(ValueError, match="read-only"):
        p.natural_frequency_hz[0] = 1.0


@given(SHARES)
def test_the_log_map_is_inverted(shares):
    theta = inside(shares)
    np.testing.assert_allclose(from_log(to_log(theta)), theta, rtol=ULPS)  # exp and log: an ulp or two each


@given(st.lists(st.floats(0.001, 0.999), min_size=15, max_size=15).map(np.array))
def test_the_sigmoid_map_is_inverted(shares):
    theta = inside(shares)
    np.testing.assert_allclose(from_sigmoid(to_sigmoid(theta)), theta, rtol=1e-12)  # a share near 0 or 1 loses 3 digits


@given(st.lists(st.floats(allow_nan=False), min_size=15, max_size=15).map(np.array))
def test_every_real_phi_gives_an_admissible_subject(phi):
    theta = from_sigmoid(phi)
    assert ((theta >= printed_bounds()[:, 0]) & (theta <= printed_bounds()[:, 1])).all()
    np.testing.assert_array_equal(Parameters.from_vector(theta).vector(), theta)


def test_the_sigmoid_map_is_the_printed_one():
    phi = np.linspace(-3.0, 4.0, 15)
    lower, upper = printed_bounds().T
    np.testing.assert_allclose(from_sigmoid(phi), lower + (upper - lower) / (1.0 + np.exp(-phi)), rtol=ULPS)  # Eq. 34
    np.testing.assert_allclose(from_sigmoid(np.zeros(15)), (lower + upper) / 2.0, rtol=ULPS)
