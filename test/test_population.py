"""Published groups of people, the population that was derived from them, and subjects beside both."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import Page, assert_self_contained
from paper import shipped

from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import SEAT, SEGMENTS, STANDARD_GRAVITY_MPS2
from biodyn_core.body.model import Chain
from biodyn_core.body.origin import origin_of
from biodyn_core.body.parameters import LOWER, STIFFENING, UPPER, Parameters
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.synthesis_settings import CASES
from biodyn_core.effects import CATALOGUE, AppliedEffect
from biodyn_core.pipeline.intervals import prediction_spread
from biodyn_core.pipeline.pipeline import Pipeline
from biodyn_core.population import beside as beside_module
from biodyn_core.population import curves as curves_module
from biodyn_core.population.beside import FACTOR, MAGNITUDE_MPS2, Softened, beside_people
from biodyn_core.population.curves import RATE_HZ, Curves, curves, peak_of, vibration
from biodyn_core.population.distribution import SPREAD, theta_of
from biodyn_core.population.population import beyond, new_subject, population, population_from, to_text
from biodyn_core.population.references import exponent, references
from biodyn_ros.commands.cli import main
from biodyn_ros.reports.exposure_json import exposure_document
from biodyn_ros.reports.exposure_report import exposure_report
from biodyn_ros.validate.people_page import write_people
from biodyn_ros.validate.people_text import text_of
from blind.population import head, page
from blind.population.coverage import SINES, averaged, covered, person_of
from blind.population.deriving import (
    BODY_MASS_KG,
    FREQUENCY_HZ,
    Derivation,
    nearest,
    places_off_bounds,
    responses,
    stiffened,
)

# --- references ------------------------------------------------------------------------------------------------------


def test_the_mean_apparent_mass_has_the_values_of_the_published_model() -> None:
    """5 Hz and 0.475, normalised at 0.5 Hz: modulus as computed by hand from the printed formula."""
    at_hz = np.array([0.5, 2.0, 4.0, 5.0, 8.0, 20.0])
    found = references().apparent_mass.mean(at_hz)
    r, z = at_hz / 5.0, 0.475
    modulus = np.sqrt((1 + (2 * z * r) ** 2) / ((1 - r**2) ** 2 + (2 * z * r) ** 2))
    np.testing.assert_allclose(np.abs(found), modulus / modulus[0], rtol=1e-12)
    phase = np.degrees(np.arctan(2 * z * r) - np.arctan2(2 * z * r, 1 - r**2))
    np.testing.assert_allclose(np.degrees(np.angle(found)), phase, atol=1e-9)
    assert np.abs(found[2]) == pytest.approx(1.48, abs=0.01)


def test_the_band_has_the_assumed_spread() -> None:
    """To first order the standard deviation of ln modulus is that of the drawn frequencies times its slope."""
    reference = references().apparent_mass
    at_hz = np.array([20.0])
    band = reference.band(at_hz)
    step = 1e-4
    by_frequency, by_damping = (
        np.log(np.abs(reference.of(np.array(5.0 * f), np.array(0.475 * z), at_hz)) / band.modulus) / step
        for f, z in ((math.exp(step), 1.0), (1.0, math.exp(step)))
    )
    spread = reference.assumed_spread
    expected = math.hypot(by_frequency[0] * spread.ln_natural_frequency, by_damping[0] * spread.ln_damping_ratio)
    assert band.modulus_sd[0] / band.modulus[0] == pytest.approx(expected, rel=0.06)


def test_exponents_are_those_of_the_abstracts() -> None:
    assert [round(one.exponent, 3) for one in references().softening] == [-0.195, -0.152]
    assert exponent((0.5, 2.0), (5.0, 2.5)) == pytest.approx(-0.5)


@pytest.mark.parametrize("factor", [0.4, 0.6, 1.0, 1.9, 2.1, -1.0])
def test_softening_agrees_with_the_sign_and_within_a_factor(factor: float) -> None:
    published = references().softening[0]
    high_hz = 5.0 * (published.magnitudes_mps2[1] / published.magnitudes_mps2[0]) ** (factor * published.exponent)
    assert Softened(published, (5.0, high_hz)).agrees == (1.0 / FACTOR <= factor <= FACTOR)


# --- curves ----------------------------------------------------------------------------------------------------------


def test_the_vibration_has_its_magnitude_and_band() -> None:
    motion = vibration()
    assert motion.std() == pytest.approx(1.0)
    power = np.abs(np.fft.rfft(motion)) ** 2
    frequency_hz = np.fft.rfftfreq(motion.size, 1.0 / RATE_HZ)
    inside = (frequency_hz >= 0.25) & (frequency_hz <= 25.0)
    assert power[~inside].sum() < 1e-20 * power.sum()
    np.testing.assert_allclose(power[inside], power[inside].mean(), rtol=1e-6)


def test_curves_are_those_of_the_matrices_without_stiffening() -> None:
    """The simulated curves beside the exact response of the linear chain; the window smooths the resonance a little."""
    subject = shipped("subject_1")
    linear = dataclasses.replace(subject, parameters=dataclasses.replace(subject.parameters, stiffening_scale=0.0))
    found, chain = curves(linear, 1.0), Chain.of(linear)
    exact = chain.apparent_mass(found.frequency_hz)
    np.testing.assert_allclose(found.apparent_mass, exact / np.abs(exact[0]), atol=0.05)
    np.testing.assert_allclose(found.head, chain.transmissibility(found.frequency_hz)[:, -1], atol=0.1)


def test_an_effect_and_channels_that_a_laboratory_has_not_are_simulated() -> None:
    tilted = AppliedEffect(CATALOGUE["cross_axis"], "head", {"beta_x": 0.3, "beta_y": 0.1, "corner_hz": 20.0})
    hard = AppliedEffect(CATALOGUE["cubic"], "central_torso", {"cubic_per_m2": 3e5})
    plain, changed = (
        curves(dataclasses.replace(shipped("subject_1"), effects=effects), 2.0)
        for effects in ((tilted,), (tilted, hard))
    )
    assert changed.resonance_hz > plain.resonance_hz + 0.05


def test_a_peak_lies_between_lines() -> None:
    frequency_hz = np.arange(0.5, 20.0, 0.125)
    at_hz, value = peak_of(frequency_hz, 3.0 - (frequency_hz - 4.03) ** 2)
    assert (at_hz, value) == (pytest.approx(4.03), pytest.approx(3.0))
    falling = peak_of(frequency_hz, 1.0 / frequency_hz)
    assert falling == (1.0, pytest.approx(1.0))


def curves_of(modulus: np.ndarray, magnitude_mps2: float = 1.0) -> Curves:
    """Curves with that modulus of the apparent mass, and no motion of the head."""
    return Curves(magnitude_mps2, FREQUENCIES_HZ, modulus + 0j, np.ones_like(modulus) + 0j)


FREQUENCIES_HZ = np.arange(0.5, 20.0, 0.125)


def test_the_end_of_the_searched_band_is_no_resonance() -> None:
    assert curves_of(1.0 / FREQUENCIES_HZ).resonance_hz is None
    assert curves_of(1.0 + FREQUENCIES_HZ).resonance_hz is None
    for at_hz in (1.0, 4.0, 12.0):  # a peak on the first or last line of the band is one
        assert curves_of(1.0 / (1.0 + (FREQUENCIES_HZ - at_hz) ** 2)).resonance_hz == pytest.approx(at_hz)


def test_a_subject_that_diverges_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curves_module, "SECONDS", 30.0)
    with pytest.raises(InputError, match=r"subject_1: the model diverges at 1e\+09 m/s\^2"):
        curves(shipped("subject_1"), 1e9)


# --- beside the groups -----------------------------------------------------------------------------------------------


def test_the_papers_subjects_lie_outside_where_their_resonance_is() -> None:
    found = beside_people(shipped("subject_1"))
    modulus = [one for one in found.outside if one.quantity == "modulus"]
    above = next(one for one in modulus if one.begin_hz < 3.5 < one.end_hz)
    assert above.value > above.upper and above.value == pytest.approx(1.79, abs=0.02)
    below = next(one for one in modulus if one.begin_hz < 6.5 < one.end_hz)
    assert below.value < below.lower
    assert not any(one.agrees for one in found.softened)
    within = np.abs(np.abs(found.curves.apparent_mass) - found.band.modulus) <= found.band.modulus_sd
    assert found.share_within(1.0)[0] == pytest.approx(np.mean(within[1:]))


def test_the_mean_of_the_population_agrees_with_the_group() -> None:
    found = beside_people(new_subject("me", 75.0, 1.75))
    modulus, phase = found.share_within(1.0)
    assert modulus >= 0.9 and phase >= 0.9 and not found.outside
    assert all(one.agrees for one in found.softened)


def test_the_line_that_normalises_the_modulus_is_not_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    """The modulus at 0.5 Hz is 1 for everybody: rounding there is no difference between people."""
    me = new_subject("me", 75.0, 1.75)
    found = beside_people(me)

    def rounded(*given: Any) -> Curves:
        return dataclasses.replace(found.curves, apparent_mass=found.curves.apparent_mass * off)

    off = np.ones(found.curves.frequency_hz.size)
    off[0] = 1.0 + 4.0 * np.finfo(float).eps
    monkeypatch.setattr(beside_module, "curves", rounded)
    again = beside_people(me)
    assert again.share_within(1.0) == found.share_within(1.0) and again.outside == found.outside == ()


def test_without_a_resonance_nothing_agrees_and_the_text_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A resonance of 1.5 Hz, and none at the larger magnitude: 1 Hz there would give the published exponent."""

    def drawn(subject: Subject, magnitude_mps2: float, as_printed: bool = False) -> Curves:
        if magnitude_mps2 < 1.0:
            return curves_of(1.0 / (1.0 + (FREQUENCIES_HZ - 1.5) ** 2), magnitude_mps2)
        return curves_of(1.0 / FREQUENCIES_HZ, magnitude_mps2)

    monkeypatch.setattr(beside_module, "curves", drawn)
    found = beside_people(shipped("subject_1"))
    published = references().softening[0]
    assert exponent(published.magnitudes_mps2, (1.5, 1.0)) == pytest.approx(published.exponent, rel=0.01)
    assert [one.resonances_hz for one in found.softened] == [(pytest.approx(1.5), None)] * 2
    assert not any(one.agrees for one in found.softened)
    lines = text_of(found).splitlines()
    assert "no resonance from 1 to 12 Hz at 1 m/s^2 rms" in lines
    assert any(
        line.startswith(
            "outside: resonance 1.50 Hz at 0.25 m/s^2, no resonance from 1 to 12 Hz at 2 m/s^2, of 8 people"
        )
        for line in lines
    )
    write_people(found, tmp_path)
    document = json.loads((tmp_path / "people.json").read_text(encoding="utf-8"))
    assert document["apparent_mass"]["resonance_hz"] is None
    assert [(one["resonances_hz"][1], one["exponent"], one["agrees"]) for one in document["softening"]] == [
        (None, None, False)
    ] * 2
    assert "no resonance from 1 to 12 Hz" in Page((tmp_path / "people.html").read_text(encoding="utf-8")).text


def test_forces_of_a_cascade_are_refused() -> None:
    with pytest.raises(InputError, match="cascade"):
        beside_people(shipped("subject_1_as_printed"))


# --- the population --------------------------------------------------------------------------------------------------


def test_the_page_has_the_spread_of_people_and_not_the_slope_at_the_mean() -> None:
    """Places are normal, so each deviation is an integral over one place; the slope alone misses half of one."""
    of = population().at_rest
    low, high = np.log(LOWER[SPREAD]), np.log(UPPER[SPREAD])
    nodes, weights = np.polynomial.hermite_e.hermegauss(100)
    places = of.mean[:, None] + np.sqrt(np.diag(of.covariance))[:, None] * nodes
    logarithm = low[:, None] + (high - low)[:, None] / (1.0 + np.exp(-places))
    share = weights / weights.sum()
    mean = logarithm @ share
    expected = np.sqrt(((logarithm - mean[:, None]) ** 2) @ share)
    # The estimate of a standard deviation of 20,000 draws errs by 0.5 %, and by more where a tail is long.
    np.testing.assert_allclose(page.deviations(of), expected, rtol=0.04)
    assert page.deviations(of)[2] == pytest.approx(0.12, abs=0.005)
    published = (Path(__file__).parents[1] / "docs" / "people.md").read_text(encoding="utf-8")
    assert "\n".join(page.parameter_table(of)) in published


@pytest.mark.slow
def test_people_of_the_population_have_the_spread_of_the_group() -> None:
    """Mean within one standard deviation nearly everywhere, the spread within a factor of 2.2, from 1 Hz on."""
    drawn = [
        curves(person_of(theta), MAGNITUDE_MPS2) for theta in population().at_rest.draw(np.random.default_rng(3), 30)
    ]
    band = references().apparent_mass.band(drawn[0].frequency_hz)
    modulus, from_1_hz = np.abs([one.apparent_mass for one in drawn]), band.frequency_hz >= 1.0
    away = np.abs(modulus.mean(axis=0) - band.modulus) / band.modulus_sd
    assert np.mean(away[from_1_hz] < 1.0) > 0.85
    ratio = (modulus.std(axis=0) / band.modulus_sd)[from_1_hz]
    assert ratio.min() > 0.6 and ratio.max() < 2.5 and 0.8 < np.median(ratio) < 1.4


def test_places_lie_within_table_1_and_their_covariance_is_that_of_small_changes() -> None:
    rng = np.random.default_rng(0)
    theta = theta_of(20.0 * rng.normal(size=(50, 13)))
    assert np.all(theta >= LOWER * (1 - 1e-12)) and np.all(theta <= UPPER * (1 + 1e-12)) and np.all(theta[:, -1] == 1.0)
    of = population().at_rest
    small = dataclasses.replace(of, covariance=1e-6 * of.covariance)
    drawn = np.cov(np.log(small.draw(rng, 20000)[:, SPREAD]).T)
    scale = np.sqrt(np.outer(np.diag(drawn), np.diag(drawn)))
    np.testing.assert_allclose(drawn / scale, 1e-6 * of.spread.covariance / scale, atol=0.05)


def test_the_text_of_a_population_is_read_back_and_another_version_is_refused() -> None:
    of = population()
    again = population_from(to_text(of))
    for one, other in ((again.at_rest, of.at_rest), (again.without_softening, of.without_softening)):
        np.testing.assert_array_equal(one.mean, other.mean)
        np.testing.assert_array_equal(one.covariance, other.covariance)
    stored = json.loads(to_text(of)) | {"version": 9}
    with pytest.raises(InputError, match="version 9, expected 2"):
        population_from(json.dumps(stored))


def test_the_packaged_population_is_what_the_stated_derivation_gives() -> None:
    """Its mean, derived again; the covariance takes `make blind ARGS=population`."""
    how = Derivation(**population().provenance["derivation"])
    centre = nearest(references().apparent_mass.mean(FREQUENCY_HZ), np.zeros(13), how.centre_spread, how)
    at_rest = stiffened(theta_of(centre), how.softening, how.rate_mps)
    np.testing.assert_allclose(theta_of(population().at_rest.mean), theta_of(places_off_bounds(at_rest)), rtol=2e-3)
    assert population().softening == {"softening": how.softening, "rate_mps": how.rate_mps, "tau_s": how.tau_s}


def test_a_stiffened_chain_with_thixotropy_has_the_curves_of_the_given_one() -> None:
    """Statistical linearisation beside the simulated effect: the curves at the magnitude of the comparison stay."""
    how = Derivation()
    theta = shipped("subject_1").parameters.vector() * np.array([*[0.7] * 6, *[0.9] * 6, 1.0, 1.0, 1.0])
    theta = np.maximum(theta, LOWER)
    theta[STIFFENING] = LOWER[STIFFENING]
    linear = Subject("linear", BODY_MASS_KG, 1.75, "segment", Parameters.from_vector(theta))
    at_rest = stiffened(theta, 0.5, how.rate_mps)
    values = {"softening": 0.5, "rate_mps": how.rate_mps, "tau_s": how.tau_s}
    effects = tuple(AppliedEffect(CATALOGUE["thixotropy"], segment, values) for segment in SEGMENTS)
    soft = dataclasses.replace(linear, parameters=Parameters.from_vector(at_rest), effects=effects)
    given, found, still = (curves(one, MAGNITUDE_MPS2) for one in (linear, soft, dataclasses.replace(soft, effects=())))
    apart, without = (np.abs(one.apparent_mass - given.apparent_mass).max() for one in (found, still))
    assert apart < 0.12 < 0.4 * without
    np.testing.assert_array_equal(stiffened(theta, 0.5, how.rate_mps, ("head",))[:5], theta[:5])


def test_nearest_finds_a_chain_with_the_apparent_mass_of_a_drawn_one() -> None:
    target = responses(population().at_rest.draw(np.random.default_rng(4), 1)[0])[0]
    found = nearest(target, population().at_rest.mean, 1.0, Derivation())
    assert np.sqrt(np.mean(np.abs(responses(theta_of(found))[0] - target) ** 2)) < 0.02


def test_viscera_in_the_frequency_domain_are_those_of_the_simulation() -> None:
    values = {"mass_kg": 8.0, "natural_frequency_hz": 5.0, "damping_ratio": 0.3}
    theta = theta_of(population().at_rest.mean)
    subject = Subject("me", BODY_MASS_KG, 1.75, "segment", Parameters.from_vector(theta))
    effect = AppliedEffect(CATALOGUE["viscera"], "central_torso", values)
    found = curves(dataclasses.replace(subject, effects=(effect,)), 0.1)
    carried, transmitted = head.responses(theta, "central_torso", np.array(list(values.values())))
    at = np.searchsorted(found.frequency_hz, FREQUENCY_HZ[1:-1])
    np.testing.assert_allclose(found.head[at], transmitted[1:-1], atol=0.1)
    np.testing.assert_allclose(found.apparent_mass[at], carried[1:-1], atol=0.05)  # the seat carries the viscera too
    without = head.responses(theta, None, np.empty(0))
    np.testing.assert_allclose(without[0], responses(theta)[0], rtol=1e-9)
    np.testing.assert_allclose(without[1], responses(theta)[1], rtol=1e-9)


# --- a new subject ---------------------------------------------------------------------------------------------------


def test_a_new_subject_has_masses_in_proportion_and_the_same_normalised_curves() -> None:
    light, heavy = (new_subject("me", mass, 1.75) for mass in (50.0, 100.0))
    np.testing.assert_allclose(Chain.of(heavy).mass_kg, 2.0 * Chain.of(light).mass_kg)
    np.testing.assert_allclose(
        Chain.of(heavy).modes().natural_frequency_hz, Chain.of(light).modes().natural_frequency_hz
    )
    assert origin_of(light) == "group"
    assert [(one.effect.name, one.site) for one in light.effects] == [("thixotropy", name) for name in SEGMENTS]


@pytest.mark.parametrize(
    ("mass", "stature", "word"), [(39.0, 1.7, "39 kg"), (121.0, 1.7, "121 kg"), (75.0, 2.05, "2.05 m"), (75.0, 1.7, "")]
)
def test_beyond_the_groups_a_subject_is_marked(mass: float, stature: float, word: str) -> None:
    reason = beyond(mass, stature)
    assert (word in reason) if word else reason == ""
    assert new_subject("me", mass, stature).provenance["population"].get("extrapolated", "") == reason


def test_a_mass_that_nobody_has_is_refused() -> None:
    with pytest.raises(InputError, match="body_mass_kg is 230"):
        new_subject("me", 230.0, 1.75)


@pytest.mark.parametrize(
    ("provenance", "origin"),
    [
        ({"fitted": [{"sha256": "0"}], "population": {}}, "person"),
        ({"population": {}}, "group"),
        ({"source": "Zaman et al., Table 4"}, "paper"),
        ({"source": "me"}, "unknown"),
        ({}, "unknown"),
    ],
)
def test_the_origin_is_that_of_the_provenance(provenance: dict[str, Any], origin: str) -> None:
    assert origin_of(dataclasses.replace(shipped("subject_1"), provenance=provenance)) == origin


def ridden(subject: Subject) -> Pipeline:
    """A pipeline that a shaking seat went through."""
    t = np.arange(12.0 * RATE_HZ) / RATE_HZ
    up = np.where(t > 2.0, 1.5 * np.sin(2 * np.pi * 4.0 * t) + np.sin(2 * np.pi * 9.0 * t), 0.0)
    accel = np.column_stack([0.0 * up, 0.0 * up, STANDARD_GRAVITY_MPS2 + up])
    pipeline = Pipeline(subject)
    pipeline.push(SEAT, np.round(1e9 * (t + 1.0)).astype(np.int64), accel)
    pipeline.finish()
    return pipeline


@pytest.mark.slow
def test_predictions_of_a_new_subject_carry_the_spread_of_the_population() -> None:
    """People who are drawn and predicted one by one on roads and shocks, beside the intervals of the mean."""
    pipeline = ridden(new_subject("me", 75.0, 1.75))
    assert pipeline.no_interval == ""
    assert "held-out" in pipeline.not_monitored
    shares = covered(15)
    for motions in (CASES, SINES):
        found = averaged(shares, motions)
        assert all(85.0 <= share <= 99.5 for share in found.values()), found


def test_the_report_of_a_new_subject_says_whom_its_interval_describes() -> None:
    report = exposure_report(ridden(new_subject("me", 75.0, 1.75)))
    assert report.origin == "group"
    assert any("people of this mass in published groups" in note for note in report.interval_notes)
    document = exposure_document(report)
    assert document["origin"] == "group" and document["no_interval"] is None
    joint = document["joint_forces"]["pelvis"]
    assert joint["rms_interval_n"] is not None
    for peak in ("compression", "tension"):
        lower, upper = joint[f"{peak}_interval_n"]
        assert lower < joint[f"{peak}_n"] < upper


# --- commands --------------------------------------------------------------------------------------------------------


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Exit code, output and errors of a command."""
    try:
        code = main(list(arguments))
    except SystemExit as end:
        code = int(end.code or 0)
    output = capsys.readouterr()
    return code, output.out, output.err


def test_a_new_subject_is_written_and_read_back(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "people" / "me.yaml"
    code, out, err = run(capsys, "subject", "new", "--mass", "75", "--stature", "1.75", "-o", str(path))
    assert (code, err) == (0, "") and "no recording" in out
    subject = load_subject(path)
    assert (subject.name, subject.body_mass_kg, subject.stature_m) == ("me", 75.0, 1.75)
    assert prediction_spread(subject)[1] == ""
    other = ("--mass", "80", "--stature", "1.8", "--name", "X")
    code, out, _ = run(capsys, "subject", "new", *other, "-o", str(path), "--force", "--json")
    assert code == 0 and json.loads(out)["name"] == load_subject(path).name == "X"


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (("--mass", "75", "-o", "me.yaml"), "--stature"),
        (("--mass", "heavy", "--stature", "1.7", "-o", "me.yaml"), "heavy"),
        (("--mass", "nan", "--stature", "1.7", "-o", "me.yaml"), "body_mass_kg is nan"),
        (("--mass", "20", "--stature", "1.7", "-o", "me.yaml"), "body_mass_kg is 20, allowed are 30 to 200"),
        (("--mass", "75", "--stature", "1.7", "-o", "there.yaml"), "there.yaml exists"),
        (("--mass", "75", "--stature", "1.7", "-o", "there.yaml/me.yaml"), "there.yaml"),
        (("--mas", "75", "--stature", "1.7", "-o", "me.yaml"), "did you mean --mass"),
    ],
)
def test_a_subject_that_cannot_be_made_is_one_line_and_no_file(
    arguments: tuple[str, ...], wanted: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("there.yaml").write_text("mine", encoding="utf-8")
    code, out, err = run(capsys, "subject", "new", *arguments)
    assert (code, out) == (2, "") and wanted in err and len(err.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["there.yaml"]
    assert Path("there.yaml").read_text(encoding="utf-8") == "mine"


def test_an_extrapolated_subject_is_made_with_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "me.yaml"
    code, _, err = run(capsys, "subject", "new", "--mass", "130", "--stature", "1.7", "-o", str(path))
    assert code == 0 and path.exists()
    assert err.strip() == "biodyn subject new: warning: 130 kg is beyond 40 to 120 kg: the subject is extrapolated"


def test_a_subject_beside_the_groups_is_a_document_and_a_page(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, out, err = run(
        capsys, "validate", "--people", "--subject", "subject_2", "-o", str(tmp_path / "out"), "--json"
    )
    assert (code, err) == (0, "")
    document = json.loads((tmp_path / "out" / "people.json").read_text(encoding="utf-8"))
    assert json.loads(out) == document
    assert document["origin"] == "paper" and document["head"]["peak"] == pytest.approx(3.63, abs=0.02)
    assert [one["agrees"] for one in document["softening"]] == [False, False]
    source = (tmp_path / "out" / "people.html").read_text(encoding="utf-8")
    assert_self_contained(source)
    page = Page(source)
    assert "Differs from the groups" in page.text and "printed in the paper" in page.text
    first = document["outside"][0]
    assert f"from {first['begin_hz']:g} to {first['end_hz']:g} Hz" in page.text
    assert "Not confirmed in any source" in page.text and "ISO 5982" in page.text


def test_the_text_names_what_lies_outside_and_what_is_not_judged(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "validate", "--people", "--subject", "subject_1")
    assert code == 0
    assert (
        "outside: modulus from 2.5 to 4.125 Hz: 1.79 at 3.5 Hz, 1.24 to 1.59 is mean and 2 standard deviations" in out
    )
    assert "not judged: seat-to-head transmissibility" in out and "The spread between people is assumed" in out


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (("--time", "log"), "--time"),
        (("--cutoff-hz", "80", "--case", "rail"), "--case, --cutoff-hz"),
        (("--map", "seat=/imu"), "--map"),
    ],
)
def test_options_of_a_bag_are_refused_without_one(
    given: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, _, err = run(capsys, "validate", "--people", "--subject", "subject_1", *given)
    assert (code, err) == (2, f"biodyn validate: --people compares without a bag: omit {named}\n")


@pytest.mark.parametrize("given", [("bag.mcap", "--people"), ()])
def test_either_a_bag_or_the_groups(given: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = run(capsys, "validate", *given, "--subject", "subject_1")
    assert (code, err) == (2, "biodyn validate: either BAG or --people is needed; biodyn validate -h shows how\n")
