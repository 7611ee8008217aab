"""Shares of ranges: of scales by their logarithm, of everything else as it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biodyn_core.effects import CATALOGUE, EffectParameter, Ranges

TAU = EffectParameter("tau_s", "s", 0.01, 1.0, 0.1)
GAIN = EffectParameter("gain", "", -0.3, 0.3, 0.05, "strength")
FORCE = EffectParameter("yield_n", "N", 0.0, 500.0, 20.0, "strength")
BAND = EffectParameter("frequency_hz", "Hz", 10.0, 80.0, 30.0)


def test_half_a_range_of_scales_is_its_geometric_middle() -> None:
    assert TAU.share(0.1) == pytest.approx(0.5) and TAU.at_share(0.25) == pytest.approx(10.0**-1.5)


def test_half_of_any_other_range_is_its_middle() -> None:
    assert [p.at_share(0.5) for p in (GAIN, FORCE, BAND)] == pytest.approx([0.0, 250.0, 45.0])


def test_a_small_value_of_a_wide_range_is_not_on_its_bound() -> None:
    """0.02 s of 0.005 to 3 s is half a percent of the range from its end, and four times its end."""
    tau = next(p for p in CATALOGUE["relaxation"].parameters if p.name == "tau_s")
    assert not tau.on_bound(0.02) and tau.on_bound(0.00501) and tau.on_bound(2.99)
    slack = next(p for p in CATALOGUE["harness"].parameters if p.name == "slack_m")
    assert not slack.on_bound(0.0) and slack.on_bound(0.05)


@given(st.data())
def test_maps_of_ranges_are_inverted_and_values_stay_inside(data) -> None:
    effect = data.draw(st.sampled_from([one for one in CATALOGUE.values() if one.parameters]))
    share = np.array([data.draw(st.floats(0.001, 0.999)) for _ in effect.parameters])
    ranges = Ranges(effect.parameters)
    values = ranges.values(share)
    np.testing.assert_allclose(ranges.shares(values), share, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(ranges.bounded(ranges.unbounded(values, 1e-6)), values, rtol=1e-9, atol=1e-12)
    ends = [ranges.bounded(np.full(share.size, end)) for end in (-1e3, 1e3)]
    np.testing.assert_array_equal(ends, [[p.lower for p in effect.parameters], [p.upper for p in effect.parameters]])
