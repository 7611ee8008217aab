"""DRI and HIC: pulses of seat and head, compared with closed forms and brute force."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from biodyn_core.base.segments import HEAD, SEAT
from biodyn_core.conditioning.conditioning_settings import ConditioningSettings
from conformance import record, twins
from conformance.record import GRAVITY_MPS2
from conformance.table import Row, RowTable
from conformance.twins import Mode

Floats = NDArray[np.float64]

SECONDS: Final = 2.5
BEGIN_S: Final = 1.2
WIDE_RANGE: Final = ConditioningSettings(saturation_mps2=2000.0)
"""Pulses of tens of g need high-g sensors."""

ROUNDING: Final = 1e-6

DRI_RATES_HZ: Final = (250.0, 500.0, 1129.3, 4000.0)
OMEGA, ZETA = 52.9, 0.224
HALF_SINES: Final = ((5.0, 0.05), (5.0, 0.08), (-5.0, 0.08), (10.0, 0.1), (8.0, 0.2))
"""Peak in g and length in seconds."""

HIC_RATES_HZ: Final = (250.0, 500.0, 1129.3, 4000.0)
WINDOWS_S: Final = {"hic15": 0.015, "hic36": 0.036}
BRUTE_RATE_HZ: Final = 20_000.0


# --- DRI -------------------------------------------------------------------------------------------------------------


def dri_rows(rate_hz: float) -> list[Row]:
    """DRI of half-sine pulses, a step and a decaying oscillation."""
    rows = []
    for high, length_s in HALF_SINES:
        modes = twins.tone(high * GRAVITY_MPS2, 0.5 / length_s, 0.5, BEGIN_S)
        rows += _dri(f"half-sine, {high:g} g, {1e3 * length_s:g} ms, at {rate_hz:g} Hz", modes, rate_hz, length_s)
    decay = twins.decay(3.0 * GRAVITY_MPS2, 8.0, 0.2, BEGIN_S)
    rows += _dri(f"8 Hz from 3 g, decaying with 0.2 s, at {rate_hz:g} Hz", decay, rate_hz, 0.0625)
    jump_s = (math.ceil(BEGIN_S * rate_hz) + 0.5) / rate_hz
    found = _seat(twins.step(3.0 * GRAVITY_MPS2, jump_s), rate_hz)
    overshoot = math.exp(-math.pi * ZETA / math.sqrt(1.0 - ZETA**2))
    allowed = (OMEGA / rate_hz) ** 2 / 6.0
    rows.append(
        Row(f"compression, jump to 3 g, at {rate_hz:g} Hz", found["compression"], 3.0 * (1.0 + overshoot), allowed)
    )
    return rows


def _dri(what: str, modes: list[Mode], rate_hz: float, turn_s: float) -> list[Row]:
    found = _seat(modes, rate_hz)
    z = twins.answer(twins.spinal_oscillator(), modes, np.arange(BEGIN_S, SECONDS, twins.FINE_S))
    ratio = OMEGA**2 / GRAVITY_MPS2
    # First part: linear interpolation of a half-sine; second part: a peak between two samples.
    allowed = (math.pi / (turn_s * rate_hz)) ** 2 / 12.0 + (OMEGA / rate_hz) ** 2 / 8.0
    return [
        Row(f"compression, {what}", found["compression"], ratio * float((-z).max()), allowed),
        Row(f"as printed, {what}", found["as_printed"], ratio * float(np.abs(z).max()), allowed),
    ]


def _seat(modes: list[Mode], rate_hz: float) -> dict[str, float]:
    time = record.instants(rate_hz, SECONDS)
    streams = {SEAT: record.stream(SEAT, time, twins.motion(modes, time))}
    return record.replayed(streams, conditioning=WIDE_RANGE).document["dri"]


# --- HIC -------------------------------------------------------------------------------------------------------------


def hic_of_half_sine(peak_g: float, length_s: float, window_s: float) -> float:
    """HIC of a half-sine: the window is centred; its optimal half length x has tan x = 5/3 x, unless it is limited.

    Over a fraction u of it the mean is 2 sin(pi u / 2) / (pi u).
    """
    best = optimize.brentq(lambda x: math.tan(x) - 5.0 / 3.0 * x, 0.5, 1.5) * 2.0 / math.pi
    u = min(best, window_s / length_s)
    return peak_g**2.5 * length_s * u * (2.0 * math.sin(0.5 * math.pi * u) / (math.pi * u)) ** 2.5


def hic_rows(rate_hz: float) -> list[Row]:
    """HIC15 and HIC36 of levels, half-sines and a decaying oscillation of the head."""
    return [*level_rows(rate_hz), *_half_sine_rows(rate_hz), *_decay_rows(rate_hz)]


def level_rows(rate_hz: float) -> list[Row]:
    """A level of 60 ms is longer than every window, so that the result is exact."""
    jump_s = (math.ceil(BEGIN_S * rate_hz) + 0.5) / rate_hz
    unit = [Mode(jump_s, 0j, GRAVITY_MPS2), Mode(jump_s + 0.06, 0j, -GRAVITY_MPS2)]
    up, down, oblique = (_head(unit, rate_hz, *axes) for axes in ((0.0, 20.0), (0.0, -20.0), (12.0, 16.0)))
    wanted = {
        "20 g up": (up, {"vertical": 20.0, "as_printed": 21.0}),
        "20 g down": (down, {"vertical": 20.0, "as_printed": 19.0}),
        "12 g forward and 16 g up": (oblique, {"vertical": 16.0, "resultant": 20.0}),
    }
    return [
        Row(f"{key}.{definition}, {what}, at {rate_hz:g} Hz", found[key][definition], window_s * level_g**2.5, ROUNDING)
        for key, window_s in WINDOWS_S.items()
        for what, (found, levels) in wanted.items()
        for definition, level_g in levels.items()
    ]


def _half_sine_rows(rate_hz: float) -> list[Row]:
    rows = []
    for length_s in (0.02, 0.04, 0.08):
        found = _head(twins.tone(GRAVITY_MPS2, 0.5 / length_s, 0.5, BEGIN_S), rate_hz, 0.0, 40.0)
        rows += [
            Row(
                f"{key}.vertical, half-sine, 40 g, {1e3 * length_s:g} ms, at {rate_hz:g} Hz", found[key]["vertical"],
                hic_of_half_sine(40.0, length_s, window_s), _of_samples(length_s, rate_hz),
            )
            for key, window_s in WINDOWS_S.items()
        ]  # fmt: skip
    return rows


def _decay_rows(rate_hz: float) -> list[Row]:
    modes = twins.decay(GRAVITY_MPS2, 15.0, 0.05, BEGIN_S)
    found = _head(modes, rate_hz, 0.0, 30.0)
    fine = np.arange(BEGIN_S, BEGIN_S + 0.2, 1.0 / BRUTE_RATE_HZ)
    g = 30.0 * twins.motion(modes, fine) / GRAVITY_MPS2
    rows = []
    for key, window_s in WINDOWS_S.items():
        for definition, channel in (("vertical", np.abs(g)), ("as_printed", np.abs(g + 1.0))):
            wanted = twins.head_injury(channel, BRUTE_RATE_HZ, window_s)
            what = f"{key}.{definition}, 15 Hz from 30 g, decaying with 50 ms, at {rate_hz:g} Hz"
            rows.append(Row(what, found[key][definition], wanted, _of_samples(1.0 / 30.0, rate_hz)))
    return rows


def _of_samples(turn_s: float, rate_hz: float) -> float:
    """Relative error of HIC, a mean to the power of 2.5, due to sampling.

    First part: straight lines below a half-sine of `turn_s`, by 1/12 of the squared period times the curvature over
    whole periods, and 1/11 or less over 3.75 and more. Second part: a window a quarter of a millisecond off the
    optimum, or half a sample of a faster record.
    """
    finer_hz = max(rate_hz, 2000.0)
    return 2.5 * (math.pi / turn_s) ** 2 * (1.0 / (11.0 * rate_hz**2) + 1.0 / (8.0 * finer_hz**2))


def _head(modes: list[Mode], rate_hz: float, forward: float, up: float) -> dict[str, dict[str, float]]:
    time = record.instants(rate_hz, SECONDS)
    shape = twins.motion(modes, time)
    streams = {
        SEAT: record.stream(SEAT, time, np.zeros_like(time)),
        HEAD: record.stream(HEAD, time, up * shape, forward * shape),
    }
    return record.replayed(streams, conditioning=WIDE_RANGE).document


# --- sections --------------------------------------------------------------------------------------------------------

DRI_WORDS: Final = """\
From `dri`. Reference: the oscillator of Eq. 24 in closed form; that of a level by its overshoot 1 + exp(-π ζ / √(1 -
ζ²)). Tolerance: the uncertainty of sampling at a rate f, (π / T f)² / 12 for straight lines across a half-sine of
length T plus (ω / f)² / 8 for a peak between two of them; (ω / f)² / 6 for a level."""
HIC_WORDS: Final = f"""\
From `hic15` and `hic36`, levels of 60 ms. Reference: closed forms, and brute force over all windows at
{BRUTE_RATE_HZ / 1e3:g} kHz for the decaying oscillation. A level longer than the window is exact. Otherwise the
tolerance is the uncertainty of sampling at a rate f, 2.5 (π / T)² (1 / 11 f² + 1 / 8 F²): straight lines below a
half-sine of length T, and a window half a period of F off the best. F is f, or 2000 Hz if that is more."""


def sections() -> list[RowTable]:
    """All sections; about five seconds."""
    dri = tuple(row for rate_hz in DRI_RATES_HZ for row in dri_rows(rate_hz))
    hic = tuple(row for rate_hz in HIC_RATES_HZ for row in hic_rows(rate_hz))
    return [RowTable("DRI", DRI_WORDS, dri), RowTable("HIC", HIC_WORDS, hic)]
