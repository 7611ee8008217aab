"""A recording made ready, and the errors of a prediction."""

import dataclasses

import fitting
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import MEASURED_SEGMENTS
from biodyn_core.identification.fit import mean_percent
from biodyn_core.identification.problem import Case, CaseSettings, errors, sharpened
from biodyn_core.recording.recording import WARM_UP_S, Recording

BEGIN = round(WARM_UP_S * fitting.RATE_HZ)


def some_recording(seconds: float = 6.0) -> Recording:
    """A seat, and segments that repeat it 1 to 5 times as strong."""
    seat = fitting.seat_motion("road", seconds, 3)
    return fitting.recording(seat, seat[:, None] * np.arange(1.0, 6.0))


def test_warm_up_and_masks_do_not_count() -> None:
    recording = some_recording()
    recording.measured_mps2[2000:2100, 2] = np.nan
    case = fitting.ready(recording.seat_mps2, recording.measured_mps2)
    left = recording.measured_mps2[BEGIN:]
    assert not case.compared[:BEGIN].any()
    assert case.compared[BEGIN:].sum(axis=0).tolist() == [len(left)] * 2 + [len(left) - 100] + [len(left)] * 2
    np.testing.assert_allclose(case.energy, np.nansum(left**2, axis=0), rtol=1e-14)
    np.testing.assert_allclose((case.weight * case.measured_mps2**2).sum(axis=0), 1.0, rtol=1e-12)


def test_transmissibility_and_coherence_of_pure_gains() -> None:
    case = fitting.ready(*_pair(some_recording()))
    np.testing.assert_allclose(case.transmissibility, np.tile(np.arange(1.0, 6.0), (len(case.frequency_hz), 1)))
    np.testing.assert_allclose(case.coherence, 1.0)


def test_a_missing_segment_is_left_out_and_reported() -> None:
    recording = some_recording()
    recording.measured_mps2[:, 3] = np.nan
    recording.measured_mps2[BEGIN + 200 :, 1] = np.nan
    case = fitting.ready(*_pair(recording))
    assert case.fitted == ("pelvis", "upper_torso", "head")
    assert [line.split(":")[0] for line in case.warnings] == ["lower_torso", "neck"]
    assert not case.weight[:, [1, 3]].any() and not case.coherence[:, [1, 3]].any()
    found = errors(case, case.measured_mps2)
    assert np.isnan(found.nrmse_rms_percent[[1, 3]]).all() and found.mean_percent == 0.0


def test_a_prediction_that_diverges_while_a_segment_is_missing_is_unstable_for_all() -> None:
    recording = some_recording()
    recording.measured_mps2[BEGIN + 1000 :, 4] = np.nan
    case = fitting.ready(*_pair(recording))
    predicted = case.measured_mps2.copy()
    predicted[BEGIN + 1200 :] = np.nan
    assert case.fitted[-1] == "head"
    found = errors(case, predicted)
    assert found.is_unstable and np.isnan(found.nrmse_rms_percent).all()


def test_an_unstable_prediction_is_worse_than_any_other() -> None:
    """Its error is infinite, not NaN, which would be neither smaller nor larger than others."""
    case = fitting.ready(*_pair(some_recording()))
    unstable = errors(case, np.full(case.measured_mps2.shape, np.nan))
    wrong = errors(case, case.measured_mps2 + 1e6)
    assert unstable.mean_percent == np.inf and mean_percent([unstable, wrong]) == np.inf
    assert min((unstable, wrong), key=lambda one: one.mean_percent) is wrong


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (lambda r: r.seat_mps2.__setitem__(7, np.nan), "the seat has samples that are not finite"),
        (lambda r: r.measured_mps2.__setitem__(slice(BEGIN, None), np.nan), "no segment has 0.5 s to compare"),
        (lambda r: r.measured_mps2.__setitem__((slice(None), 4), 0.0), "head does not move at all"),
    ],
)
def test_an_unusable_recording_is_refused_in_one_line(spoil, expected) -> None:
    recording = some_recording()
    spoil(recording)
    with pytest.raises(InputError, match=expected) as caught:
        Case.of(recording, fitting.SPECTRUM)
    assert "\n" not in str(caught.value) and recording.name in str(caught.value)


def test_a_record_shorter_than_a_window_names_itself() -> None:
    recording = some_recording(2.6)
    spectrum = dataclasses.replace(fitting.SPECTRUM, segment_s=4.0)
    with pytest.raises(InputError, match=r"^road: .*shorten segment_s"):
        Case.of(recording, spectrum)


@given(st.lists(st.floats(0.0, 2.0), min_size=5, max_size=5))
def test_errors_of_known_misses(shares: list[float]) -> None:
    case = fitting.ready(*_pair(some_recording(4.0)))
    found = errors(case, case.measured_mps2 * (1.0 + np.array(shares)))
    np.testing.assert_allclose(found.nrmse_rms_percent, 100.0 * np.array(shares), atol=1e-9)
    compared = case.measured_mps2[BEGIN:]
    by_range = np.array(shares) * np.sqrt((compared**2).mean(axis=0)) / np.ptp(compared, axis=0)
    np.testing.assert_allclose(found.nrmse_range_percent, 100.0 * by_range, atol=1e-9)
    assert found.mean_percent == pytest.approx(100.0 * np.mean(shares), abs=1e-9)


@pytest.mark.parametrize(("frequency_hz", "tolerance"), [(5.0, 1e-6), (20.0, 2e-5), (50.0, 4e-4)])
def test_lines_through_a_sharpened_seat_are_as_strong_as_the_seat(frequency_hz: float, tolerance: float) -> None:
    rate_hz, fine = 1129.3, 64
    n = np.arange(round(40 * rate_hz / frequency_hz))
    wave = np.cos(2.0 * np.pi * frequency_hz * n / rate_hz)
    at = np.arange((n.size - 1) * fine) / fine
    tone = np.exp(-2j * np.pi * frequency_hz * at / rate_hz) * np.hanning(at.size)

    def strength(samples: np.ndarray) -> float:
        return 2.0 * abs(np.interp(at, n, samples) @ tone) / np.hanning(at.size).sum()

    lines = np.sinc(frequency_hz / rate_hz) ** 2
    assert strength(wave) == pytest.approx(lines, abs=tolerance)
    assert strength(sharpened(wave)) == pytest.approx(1.0, abs=tolerance)


def test_settings_out_of_range_are_named() -> None:
    with pytest.raises(InputError, match="least_compared_s"):
        CaseSettings(least_compared_s=0.0)


def test_errors_name_their_segments() -> None:
    case = fitting.ready(*_pair(some_recording()))
    wrong = case.measured_mps2.copy()
    wrong[:, MEASURED_SEGMENTS.index("head")] *= 1.5
    assert errors(case, wrong).nrmse_rms_percent == pytest.approx([0.0, 0.0, 0.0, 0.0, 50.0])


def _pair(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    return recording.seat_mps2, recording.measured_mps2
