"""The conformance page: it is complete, nothing in it fails, and a part measured again gives the same figures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

import naive
import numpy as np
import pytest

from conformance import __main__ as command
from conformance import clock, grid, injury, page, recordings, start, transients, twins, weightings
from conformance.table import FAIL, Row, RowTable

PAGE = command.PAGE.read_text(encoding="utf-8")


def table(title: str) -> dict[str, list[str]]:
    """The lines of a section's table by their first cell."""
    section = re.search(rf"^### {re.escape(title)}$(.*?)(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert section, title
    lines = [line.strip("| ").split(" | ") for line in section[1].splitlines() if line.startswith("|")]
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}


def assert_printed(title: str, rows: Iterable[Row]) -> None:
    """The page has these rows with the measured values, to a tenth of the tolerance and its digits."""
    printed = table(title)
    for row in rows:
        assert row.passes, row.line()
        value, reference = (float(cell) for cell in printed[row.what][:2])
        allowed = row.tolerance if row.absolute else row.tolerance * abs(row.reference)
        assert reference == pytest.approx(row.reference, rel=1e-4, abs=0.02 * allowed), row.line()
        assert value == pytest.approx(row.value, rel=1e-4, abs=0.1 * allowed), row.line()


# --- the page --------------------------------------------------------------------------------------------------------


def test_nothing_on_the_page_fails() -> None:
    assert FAIL not in PAGE
    assert re.search(r"^\*\*[0-9]{4} comparisons, 0 failures\.\*\*$", PAGE, re.MULTILINE)


def test_every_chapter_is_on_the_page_and_counted() -> None:
    counted = dict(re.findall(r"^\| ([A-Z][A-Za-z ]+) \| ([0-9]+) \| 0 \|$", PAGE, re.MULTILINE))
    assert list(counted) == list(page.CHAPTERS)
    assert re.findall(r"^## (.*)$", PAGE, re.MULTILINE) == list(page.CHAPTERS)
    total = re.search(r"\*\*([0-9]+) comparisons", PAGE)
    assert total and int(total[1]) == sum(map(int, counted.values()))


def test_every_weighting_is_there_at_every_band_and_five_rates() -> None:
    for title in (*(f"{name}, vertical" for name in twins.WEIGHTINGS if name != "Wf"), "Wd, horizontal"):
        lines = table(title)
        assert [f"{rate_hz:g} Hz" for rate_hz in weightings.RATES_HZ] == lines["Hz"][2:]
        for band in range(-3, 20):
            gains = [float(gain) for gain in lines[f"{weightings.frequency(band):.4g}"][2:]]
            assert len(gains) == len(weightings.RATES_HZ) == 5
    sickness = table("Wf, motion sickness")
    assert all(f"{weightings.frequency(band):.4g}" in sickness for band in weightings.SICKNESS_BANDS)


def test_every_transient_fault_pulse_and_rate_is_there() -> None:
    for rate_hz in transients.TOLERANCES:
        there = table(f"Transients at {rate_hz:g} Hz")
        for what in transients.MOTIONS:
            assert {f"Wk {name}, {what}" for name in transients.NAMES.values()} <= set(there)
            assert {f"{name} VDV, {what}" for name in transients.ALSO} <= set(there)
    there = table("Faults of the stamps")
    assert {f"{fault.what}: {figure}" for fault in clock.FAULTS for figure in ("aw", "VDV")} <= set(there)
    assert all(f"compression, jump to 3 g, at {rate_hz:g} Hz" in table("DRI") for rate_hz in injury.DRI_RATES_HZ)
    assert all(f"hic15.vertical, 20 g up, at {rate_hz:g} Hz" in table("HIC") for rate_hz in injury.HIC_RATES_HZ)
    assert all(f"delay taken off at {rate_hz:g} Hz" in table("Delay") for rate_hz in grid.RATES_HZ)
    assert all(f"0.5 samples late at {rate_hz:g} Hz, error" in table("Interpolation") for rate_hz in grid.RATES_HZ)
    assert len(table("HIC of recorded head impacts")) == 2 + 4
    assert len(table("DRI of seat pulses")) == 2 + 5


def test_a_failing_row_is_named_and_ends_the_command_with_an_error(monkeypatch, tmp_path, capsys) -> None:
    good, bad = Row("a", 1.0005, 1.0, 1e-3), Row("b", 1.002, 1.0, 1e-3)
    monkeypatch.setattr(recordings, "data", lambda: tmp_path)
    monkeypatch.setattr(command, "PAGE", tmp_path / "docs" / "page.md")
    monkeypatch.setattr(command, "CHAPTERS", {"One": lambda: [RowTable("t", "w", (good,))]})
    assert command.main() == 0
    assert "**1 comparisons, 0 failures.**" in command.PAGE.read_text(encoding="utf-8")
    monkeypatch.setattr(command, "CHAPTERS", {"One": lambda: [RowTable("t", "w", (good, bad))]})
    assert command.main() == 1
    text = command.PAGE.read_text(encoding="utf-8")
    assert "**2 comparisons, 1 failures.**" in text
    assert f"- {FAIL} b" in text
    assert "| b | 1.0020 | 1.0000 |  | +0.200 % | 0.1 % | **FAIL** |" in capsys.readouterr().out


def test_without_the_recordings_the_page_is_not_made(monkeypatch, tmp_path, capsys) -> None:
    monkeypatch.setattr(recordings, "data", lambda: tmp_path / "nowhere")
    monkeypatch.setattr(command, "PAGE", tmp_path / "page.md")
    assert command.main() == 2
    assert not command.PAGE.exists()
    assert "BIODYN_DATA" in capsys.readouterr().err


@pytest.mark.parametrize("value", [math.nan, math.inf, 1.0011, 0.9989])
def test_deviations_and_nan_fail(value) -> None:
    assert not Row("a", value, 1.0, 1e-3).passes
    assert not Row("a", value, 1.0, 1e-3, absolute=True).passes


@pytest.mark.usefixtures("shared_data")  # the printed factors are there
def test_a_gain_fails_by_curve_and_by_print_alone() -> None:
    def gains(factor: float) -> weightings.GainTable:
        found = weightings.Gain(0, 1129.3, factor * float(twins.curve("Wk", 1.0)))
        return weightings.GainTable("t", "w", "Wk", (found,), {1129.3: 0.001})

    assert [row.passes for row in gains(1.0).rows()] == [True, True]
    assert [row.passes for row in gains(1.002).rows()] == [False, True]
    assert [row.passes for row in gains(1.04).rows()] == [False, False]
    assert FAIL in "".join(gains(1.002).lines())
    assert FAIL not in "".join(gains(1.0).lines())


# --- the references --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", twins.WEIGHTINGS)
def test_the_poles_and_zeros_are_the_formula_of_the_standard(name) -> None:
    frequency = np.geomspace(0.01, 400.0, 200)
    np.testing.assert_allclose(twins.curve(name, frequency), np.abs(naive.weighting(name, frequency)), rtol=1e-12)


@pytest.mark.parametrize("name", twins.WEIGHTINGS)
def test_the_closed_form_is_the_response_by_the_spectrum(name) -> None:
    # Enough samples a second for the kinks, or enough seconds for the slowest weighting to decay.
    rate_hz, seconds = (10_000.0, 60.0) if name == "Wf" else (40_000.0, 4.0)
    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    modes = [*twins.tone(10.0, 8.0, 2.5, 0.5), *twins.decay(5.0, 12.0, 0.1, 0.9)]
    found = twins.answer(twins.weighting(name), modes, time)
    wanted = twins.weighted(name, twins.motion(modes, time), rate_hz)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_the_oscillator_matches_its_numerical_integration() -> None:
    modes = twins.tone(50.0, 6.25, 0.5, 0.0)
    time = np.arange(0.0, 0.3, 2.5e-4)
    z = twins.answer(twins.spinal_oscillator(), modes, np.arange(0.0, 0.3, twins.FINE_S))
    wanted, _ = naive.dynamic_response(time, twins.motion(modes, time))
    assert 52.9**2 / naive.GRAVITY * -z.min() == pytest.approx(wanted, rel=2e-5)  # straight lines between points


def test_hic_of_a_half_sine_is_that_of_brute_force() -> None:
    rate_hz = 20_000.0
    pulse = 40.0 * np.sin(np.pi * np.arange(0.0, 0.02, 1.0 / rate_hz) / 0.02)
    for window_s in (0.008, 0.015):
        wanted = naive.head_injury(pulse, rate_hz, window_s)
        assert injury.hic_of_half_sine(40.0, 0.02, window_s) == pytest.approx(wanted, rel=1e-4)


# --- measured again --------------------------------------------------------------------------------------------------


def test_weightings_are_as_printed() -> None:
    """31.5 to 80 Hz at the lowest and the native rate, all weightings and directions, and one motion sickness dose."""
    length_s, bands = weightings.GROUPS[-1]
    for rate_hz in (250.0, 1129.3):
        found = weightings.vertical_gains(rate_hz, length_s, bands)
        tables = {f"{name}, vertical": (name, gains) for name, gains in found.items()}
        tables["Wd, horizontal"] = "Wd", weightings.horizontal_gains(rate_hz, length_s, bands)
        for title, (name, gains) in tables.items():
            assert_gains(title, name, gains, weightings.TOLERANCES[rate_hz])
    assert_gains("Wf, motion sickness", "Wf", [weightings.sickness_gain(250.0, -10)], weightings.MSDV_TOLERANCE)


def assert_gains(title: str, name: str, gains: list[weightings.Gain], tolerance: float) -> None:
    for gain in gains:
        curve = float(twins.curve(name, weightings.frequency(gain.band)))
        assert gain.gain == pytest.approx(curve, rel=tolerance)
        column = table(title)["Hz"].index(f"{gain.rate_hz:g} Hz")
        printed = float(table(title)[f"{weightings.frequency(gain.band):.4g}"][column])
        assert printed == pytest.approx(1000.0 * gain.gain, rel=0.02 * tolerance + 1e-4)


def test_transients_are_as_printed() -> None:
    rows = [*transients.vertical(1129.3, ["Wj"])["Wk"], *transients.horizontal(1129.3)]
    assert_printed("Transients at 1129.3 Hz", rows)


def test_the_start_of_a_record_is_as_printed() -> None:
    assert_printed("Rest", start.rest_rows())
    assert_printed("Gravity", start.gravity_rows())


def test_injury_criteria_are_as_printed() -> None:
    assert_printed("DRI", injury.dri_rows(1129.3))
    assert_printed("HIC", injury.level_rows(1129.3))


def test_faults_of_the_stamps_are_as_printed() -> None:
    assert_printed("Faults of the stamps", clock.fault_rows(clock.FAULTS[:4]))


def test_delay_and_interpolation_are_as_printed() -> None:
    assert_printed("Delay", grid.delay_rows(1129.3))
    assert_printed("Interpolation", grid.interpolation_rows(500.0))
    assert_printed("Rates", grid.mixed_rows())


def test_recorded_pulses_are_as_printed(shared_data) -> None:
    assert_printed("HIC of recorded head impacts", recordings.head_rows())
