"""The test of the residual: it is silent where the law holds, and names the segment and the time where it does not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import shipped
from streams import in_bursts, in_turn, noisy_streams, quantised, run

from biodyn_core.base.segments import MEASURED_SEGMENTS, SENSORS
from biodyn_core.body.usual_residual import LEAST_WINDOWS, PROVENANCE, UsualResidual, usual_residuals
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.pipeline.fit_monitor import FitMonitor, sensor_effects, squares_of
from biodyn_core.pipeline.frames import MeasuredFrames
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.pipeline.windows import SecondWindows
from biodyn_core.signals.octaves import BAND_NAMES, EDGES_HZ, N_BANDS, octave_squares
from biodyn_ros.reports.exposure_report import sensor_warnings

RATE_HZ = 100
NOISE_MPS2, SHARE = 0.03, 0.1
WIDTHS_HZ = np.diff([0.0, *EDGES_HZ, RATE_HZ / 2.0])
LAW = UsualResidual(tuple(NOISE_MPS2 * np.sqrt(WIDTHS_HZ / WIDTHS_HZ.sum())), (SHARE,) * N_BANDS, 100)
LAWS = dict.fromkeys(MEASURED_SEGMENTS, LAW)
EPOCH_NS = 1_700_000_000 * 10**9


def frames(seconds: int, seed: int = 0, changed: dict[str, Any] | None = None) -> MeasuredFrames:
    """A drive whose level changes from minute to minute, rest included, with a residual by the law.

    changed: by segment, the factor of the residual over seconds (s,).
    """
    rng = np.random.default_rng(seed)
    count = seconds * RATE_HZ
    minutes = rng.choice([0.0, 0.3, 1.0, 3.0], seconds // 60 + 1)
    level = np.repeat(minutes, 60 * RATE_HZ)[:count, None]
    motion = level * rng.standard_normal((count, 5))
    # The scatter of windows in time, as of events of other kinds.
    scatter = np.exp(0.2 * np.repeat(rng.standard_normal((seconds, 5)), RATE_HZ, axis=0))
    residual = scatter * np.hypot(NOISE_MPS2, SHARE * level) * rng.standard_normal((count, 5))
    for name, factor in (changed or {}).items():
        residual[:, MEASURED_SEGMENTS.index(name)] *= np.repeat(factor, RATE_HZ)
    accel = np.concatenate([motion[:, :1], motion - residual], axis=1)
    stamps_ns = EPOCH_NS + np.rint(np.arange(count) * 1e9 / RATE_HZ).astype(np.int64)
    return MeasuredFrames(stamps_ns, accel, residual)


def monitored(given: MeasuredFrames, laws: dict[str, UsualResidual] | None = None) -> FitMonitor:
    monitor = FitMonitor(LAWS if laws is None else laws)
    monitor.push(given, RATE_HZ)
    return monitor


def step(seconds: int, begin: int, end: int, factor: float) -> np.ndarray:
    return np.where((np.arange(seconds) >= begin) & (np.arange(seconds) < end), factor, 1.0)


@pytest.mark.slow
def test_a_drive_of_the_law_is_silent_for_two_hours() -> None:
    assert monitored(frames(2 * 3600)).misfits() == []


@pytest.mark.parametrize(("factor", "within_s"), [(4.0, 25), (3.0, 50)])
def test_a_larger_residual_is_named_with_its_segment_time_and_ratio(factor: float, within_s: int) -> None:
    begin, end, seconds = 300, 400, 600
    factors = step(seconds, begin, end, factor)
    given = frames(seconds, 3, {"neck": factors})
    (found,) = monitored(given).misfits()
    assert found.segment == "neck"
    assert -2 <= (found.begin_ns - EPOCH_NS) / 1e9 - begin <= within_s
    assert found.end_ns is not None and 0 <= (found.end_ns - EPOCH_NS) / 1e9 - end <= 90
    assert found.ratio > 0.6 * factor
    after = (begin + within_s) * RATE_HZ
    early = MeasuredFrames(*(column[:after] for column in given))
    assert [one.end_ns for one in monitored(early).misfits()] == [None]


def test_up_to_twice_the_usual_residual_is_no_misfit() -> None:
    assert monitored(frames(3600, 6, {"neck": step(3600, 0, 3600, 2.0)})).misfits() == []


def test_a_single_shock_is_no_misfit() -> None:
    factors = np.ones(600)
    factors[300:302] = 1000.0
    assert monitored(frames(600, 4, {"head": factors})).misfits() == []


def test_rest_does_not_end_a_misfit() -> None:
    rng = np.random.default_rng(1)
    given = frames(240, 5)
    still = np.arange(240 * RATE_HZ) >= 120 * RATE_HZ
    residual = np.where(still[:, None], NOISE_MPS2 * rng.standard_normal((240 * RATE_HZ, 5)), 3.0)
    accel = np.where(still[:, None], 0.0, given.accel_mps2)
    (found,) = monitored(given._replace(accel_mps2=accel, residual_mps2=residual), {"head": LAW}).misfits()
    assert found.end_ns is None


@settings(max_examples=15)
@given(st.lists(st.integers(0, 60 * RATE_HZ), max_size=12).map(sorted))
def test_block_cuts_change_nothing(cuts: list[int]) -> None:
    given_frames = frames(60, 2, {"head": step(60, 20, 60, 5.0)})
    monitor = FitMonitor(LAWS)
    edges = [0, *cuts, 60 * RATE_HZ]
    for begin, end in pairwise(edges):
        monitor.push(MeasuredFrames(*(column[begin:end] for column in given_frames)), RATE_HZ)
    assert monitor.misfits() == monitored(given_frames).misfits() != []


def windows(given: MeasuredFrames) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Second, mean square of the residual (5,) and of the prediction by band (6, 5) of each complete window."""
    rows = np.concatenate([given.residual_mps2, given.accel_mps2[:, 1:]], axis=1)
    found = SecondWindows().push(given.stamps_ns, rows, RATE_HZ)
    return [((one.begin_ns - EPOCH_NS) // 10**9, *squares_of(one)) for one in found]


def test_windows_are_means_of_what_was_compared() -> None:
    given = frames(5, 1)
    given.residual_mps2[150:180, 0] = np.nan  # 30 of 100 samples of one window
    given.residual_mps2[250:255, 1] = np.nan
    found = windows(given)
    assert [second for second, *_ in found] == [0, 1, 2, 3]  # the last one is not complete
    residual, predicted = zip(*[squares for _, *squares in found], strict=True)
    assert np.isnan(residual[1][0]) and np.isnan(predicted[1][:, 0]).all() and not np.isnan(residual[2]).any()
    part = slice(300, 400)
    np.testing.assert_allclose(residual[3], octave_squares(given.residual_mps2[part], RATE_HZ).sum(axis=0))
    prediction = given.residual_mps2[part] + given.accel_mps2[part, 1:]
    np.testing.assert_allclose(predicted[3], octave_squares(prediction, RATE_HZ))


def test_a_window_with_a_gap_is_left_out() -> None:
    given = frames(4, 1)
    kept = (np.arange(400) < 120) | (np.arange(400) > 180)
    assert [second for second, *_ in windows(MeasuredFrames(*(column[kept] for column in given)))] == [0, 2]


UNEVEN: dict[str, tuple[float, Callable[[np.ndarray], np.ndarray]]] = {
    **{f"{rate_hz} Hz by 1 ms": (rate_hz, lambda s: quantised(s, 1)) for rate_hz in (400.0, 800.0, 833.0, 2000.0)},
    **{f"{rate_hz} Hz by 1 ms": (rate_hz, lambda s: quantised(s, 1)) for rate_hz in (1129.3, 1600.0, 2048.0)},
    **{f"1129.3 Hz by {ms} ms": (1129.3, lambda s, ms=ms: quantised(s, ms)) for ms in (2, 4)},
    "bursts of 20 in 2 ms": (1129.3, lambda s: in_bursts(s, 20, 0.1)),
    "4 under one stamp": (1129.3, lambda s: in_bursts(s, 4, 0.0)),
}
"""Rate and stamps by name."""


@pytest.mark.parametrize("name", UNEVEN)
def test_quantised_and_bursty_stamps_have_the_windows_of_even_ones(name: str) -> None:
    rate_hz, uneven = UNEVEN[name]
    even_ns = EPOCH_NS + np.rint(np.arange(round(10.5 * rate_hz)) * 1e9 / rate_hz).astype(np.int64)
    rows = np.arange(even_ns.size, dtype=np.float64)[:, None]
    expected, found = (list(SecondWindows().push(s, rows, rate_hz)) for s in (even_ns, uneven(even_ns)))
    assert [(one.begin_ns - EPOCH_NS) // 10**9 for one in found] == list(range(10))
    for one, even in zip(found, expected, strict=True):
        assert one.rate_hz == even.rate_hz == rate_hz
        assert abs(one.rows[0, 0] - even.rows[0, 0]) <= 20 and abs(one.rows[-1, 0] - even.rows[-1, 0]) <= 20


# --- the law ---------------------------------------------------------------------------------------------------------


def by_band(given: MeasuredFrames, segment: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares (w, 6) of residual and prediction of one segment."""
    length = RATE_HZ
    parts = [slice(begin, begin + length) for begin in range(0, len(given.stamps_ns), length)]
    predicted = given.residual_mps2 + given.accel_mps2[:, 1:]
    return tuple(
        np.array([octave_squares(values[part, segment : segment + 1], RATE_HZ)[:, 0] for part in parts])
        for values in (given.residual_mps2, predicted)
    )


def test_the_law_is_recovered_from_windows() -> None:
    residual, predicted = by_band(frames(1200, 7))
    law = UsualResidual.of_windows(residual, predicted)
    assert law is not None and law.windows == len(residual) == 1200
    # The mean of a logarithm is below the logarithm of the mean, the more so in bands of few frequencies.
    np.testing.assert_allclose(law.noise_mps2[2:], LAW.noise_mps2[2:], rtol=0.25)
    np.testing.assert_allclose(law.share[2:], SHARE, rtol=0.25)
    assert UsualResidual.of_windows(residual[: LEAST_WINDOWS - 1], predicted[: LEAST_WINDOWS - 1]) is None


def test_a_share_of_one_band_stays_in_its_band() -> None:
    rng = np.random.default_rng(3)
    level = np.exp(rng.uniform(-3.0, 1.0, (400, 1)))
    predicted = level**2 * np.ones(N_BANDS)
    share = np.array([0.02, 0.02, 0.5, 0.02, 0.02, 0.02])
    law = UsualResidual.of_windows(predicted * share**2 * np.exp(0.1 * rng.standard_normal((400, N_BANDS))), predicted)
    assert law is not None
    np.testing.assert_allclose(law.share, share, rtol=0.1)


def test_a_band_without_motion_takes_the_share_of_all() -> None:
    rng = np.random.default_rng(4)
    predicted = np.exp(rng.uniform(-3.0, 1.0, (100, 1))) * np.array([0.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    law = UsualResidual.of_windows(1e-4 + 0.04 * predicted, predicted)
    assert law is not None
    np.testing.assert_allclose(law.share, 0.2, rtol=0.2)


def test_windows_at_rest_alone_give_a_law_of_noise() -> None:
    law = UsualResidual.of_windows(np.full((30, N_BANDS), 1e-4), np.zeros((30, N_BANDS)))
    assert law is not None and law.noise_mps2 == pytest.approx([0.01] * N_BANDS, rel=0.01)


def test_the_mapping_is_read_back_in_any_order() -> None:
    given = LAW.to_dict()
    given["share"] = dict(sorted(given["share"].items(), reverse=True))
    assert usual_residuals({PROVENANCE: {"head": given}}) == ({"head": LAW}, "")


@pytest.mark.parametrize(
    ("given_law", "why"),
    [
        (None, "its file has no residual of held-out events"),
        ({}, "its file has no residual of held-out events"),
        ([], "is not by segment"),
        ({"knee": LAW.to_dict()}, "is not by segment"),
        ({"head": LAW.to_dict() | {"share": dict.fromkeys(BAND_NAMES, -1.0)}}, "usual_residual.head in its file needs"),
        (
            {"head": LAW.to_dict() | {"share": dict.fromkeys(BAND_NAMES, float("nan"))}},
            "usual_residual.head in its file needs",
        ),
        (
            {"head": LAW.to_dict() | {"noise_mps2": dict.fromkeys(BAND_NAMES, 10**400)}},
            "usual_residual.head in its file needs",
        ),
        ({"head": LAW.to_dict() | {"share": {"below_2_hz": 0.1}}}, "usual_residual.head in its file needs"),
        ({"head": LAW.to_dict() | {"share": 0.1}}, "usual_residual.head in its file needs"),
        (
            {"head": LAW.to_dict() | {"share": dict.fromkeys(BAND_NAMES, 900.0)}},
            "usual_residual.head in its file needs",
        ),
        ({"head": {"share": 0.1}}, "usual_residual.head in its file needs"),
        ({"head": LAW.to_dict() | {"windows": True}}, "usual_residual.head in its file needs"),
    ],
)
def test_a_file_without_a_valid_law_says_so_and_predictions_go_on(given_law: Any, why: str) -> None:
    provenance = {} if given_law is None else {PROVENANCE: given_law}
    assert why in usual_residuals(provenance)[1]
    pipeline = Pipeline(dataclasses.replace(shipped("subject_1"), provenance=provenance))
    assert why in pipeline.not_monitored
    result = run(noisy_streams(), in_turn(noisy_streams())[:6], pipeline=pipeline)
    assert pipeline.fit_monitor.misfits() == [] and np.isfinite(result.predicted).all()


def test_the_pipeline_names_a_sensor_that_reads_too_much() -> None:
    """A head that reads 1.5 times its motion, from the first sample on."""
    law = UsualResidual((0.05,) * N_BANDS, (0.05,) * N_BANDS, 50)
    subject = dataclasses.replace(shipped("subject_1"), provenance={PROVENANCE: {n: law.to_dict() for n in LAWS}})
    for factor, expected in ((1.0, []), (1.5, ["head"])):
        streams = [
            dataclasses.replace(s, accel_mps2=s.accel_mps2.mean(0) + factor * (s.accel_mps2 - s.accel_mps2.mean(0)))
            if s.sensor == SENSORS[-1]
            else s
            for s in noisy_streams(30.0, "road")
        ]
        pipeline = Pipeline(subject)
        run(tuple(streams), in_turn(tuple(streams)), pipeline=pipeline)
        assert [one.segment for one in pipeline.fit_monitor.misfits()] == expected


@pytest.mark.parametrize("uneven", [lambda s: quantised(s, 2), lambda s: in_bursts(s, 20, 0.1)])
def test_the_pipeline_names_it_under_quantised_and_bursty_stamps_too(uneven: Callable[..., np.ndarray]) -> None:
    law = UsualResidual((0.05,) * N_BANDS, (0.05,) * N_BANDS, 50)
    subject = dataclasses.replace(shipped("subject_1"), provenance={PROVENANCE: {n: law.to_dict() for n in LAWS}})
    streams = []
    for one in noisy_streams(30.0, "road"):
        mean = one.accel_mps2.mean(axis=0)
        accel = mean + (1.5 if one.sensor == "head" else 1.0) * (one.accel_mps2 - mean)
        streams.append(dataclasses.replace(one, stamps_ns=uneven(one.stamps_ns), accel_mps2=accel))
    pipeline = Pipeline(subject)
    run(tuple(streams), in_turn(tuple(streams)), pipeline=pipeline)
    assert [one.segment for one in pipeline.fit_monitor.misfits()] == ["head"]


def test_it_is_unknown_whether_the_model_fits_until_the_largest_misfit_could_be_found() -> None:
    """The head has a thousand times the usual residual, at 1 m/s^2 rms without a stop."""
    rng = np.random.default_rng(3)
    rows = 20 * RATE_HZ
    stamps_ns = EPOCH_NS + np.rint(np.arange(rows) * 1e9 / RATE_HZ).astype(np.int64)
    motion, residual = rng.standard_normal((rows, 5)), SHARE * rng.standard_normal((rows, 5))
    residual[:, -1] *= 1000.0
    monitor = FitMonitor(LAWS)
    states = []
    for second in range(20):
        part = slice(second * RATE_HZ, (second + 1) * RATE_HZ)
        accel = np.concatenate([motion[part, :1], motion[part] - residual[part]], axis=1)
        monitor.push(MeasuredFrames(stamps_ns[part], accel, residual[part]), RATE_HZ)
        states.append((monitor.unknown, [one.segment for one in monitor.lasting()]))
    known = [not unknown for unknown, _ in states]
    assert known == sorted(known) and 14 <= known.index(True) <= 16  # a window is whole with the sample behind it
    assert all(found == (["head"] if is_known else []) for is_known, (_, found) in zip(known, states, strict=True))
    assert states[0][0] == "no whole second in motion was compared, 15 s are needed"
    assert states[8][0] in [f"only {n} s in motion were compared, 15 s are needed" for n in (8, 9)]
    assert monitor.tested == MEASURED_SEGMENTS


def test_a_segment_with_an_effect_of_its_sensor_is_not_tested() -> None:
    """The usual residual is of the changed prediction, which streams are not compared with."""
    provenance = {PROVENANCE: dict.fromkeys(MEASURED_SEGMENTS, LAW.to_dict())}
    for sites, left in ((("head",), 4), (MEASURED_SEGMENTS, 0)):
        effects = tuple(AppliedEffect(CATALOGUE["gain"], site, {"gain": 0.3}) for site in sites)
        pipeline = Pipeline(dataclasses.replace(shipped("subject_1"), provenance=provenance, effects=effects))
        assert sensor_effects(pipeline.subject) == dict.fromkeys(sites, "gain")
        assert ("effects of its sensors" in pipeline.fit_unknown) == (left == 0)
        streams = noisy_streams(20.0, "road")
        run(streams, in_turn(streams), pipeline=pipeline)
        assert set(pipeline.fit_monitor.tested) == set(MEASURED_SEGMENTS) - set(sites)
        told = [line for line in sensor_warnings(pipeline, SENSORS) if "compared without the effect" in line]
        assert [line.partition(":")[0] for line in told] == list(sites)
