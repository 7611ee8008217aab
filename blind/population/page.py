"""The page of the population: docs/people.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.body.synthesis_settings import CASES
from biodyn_core.population.beside import MAGNITUDE_MPS2, BesidePeople, Softened
from biodyn_core.population.curves import BAND_HZ, curves, peak_of
from biodyn_core.population.distribution import NAMES, SPREAD, Distribution, theta_of
from biodyn_core.population.population import Population
from biodyn_core.population.references import Softening, references
from blind.population.coverage import SEEDS, SINE_RMS_MPS2, SINES, Coverage, averaged, person_of
from blind.population.head import MOST, HeadRow
from blind.population.softening import SofteningRow
from blind.requirements import Mark, mark_table
from conformance.table import table

HEAD: Final = f"""\
# People who were never recorded: published groups, and a subject for anybody

`biodyn subject new --mass 75 --stature 1.75 -o me.yaml` makes a subject of a population, and
`biodyn validate --people --subject S` compares any subject with published measurements of groups.

Made by `make blind ARGS=population`, which derives the population and ends with an error if a requirement is missed. Do
not edit.

A subject vibrates as in a laboratory: random vertical acceleration with a flat spectrum from {BAND_HZ[0]:g} to
{BAND_HZ[1]:g} Hz, 1 m/s^2 rms. Its apparent mass is that of the full model, with its effects, normalised by the modulus
at 0.5 Hz.
"""

REFERENCES: Final = """\
Only numbers that were read in a source are used; `biodyn_core/population/references.yaml` has where, and the
conditions. The mean is a formula that was compared with modulus and phase of the group."""

SUBJECTS: Final = (
    "Share of the frequencies from 0.5 to 20 Hz at which modulus and phase of the apparent mass are within one",
    "standard deviation of the group's mean (the modulus without 0.5 Hz, where it is 1 for everybody), both peaks,",
    "and the exponents of resonance over magnitude between the magnitudes of the two groups.",
    "",
)

SUBJECTS_MEAN: Final = """\
The paper's subjects have too high and narrow a resonance, and too little apparent mass from 6 to 9 Hz. All three
amplify the head about three times. The paper itself measured peaks of 0.57 and 0.75 on its two men. So
predictions of the head near 4 Hz are likely too large for a person who was not fitted; by how much, no confirmed
reference says."""

POPULATION: Final = """\
{people} people were drawn around the published mean. For each, parameters were sought whose apparent mass agrees
with that of the drawn person, with a tolerance of {tolerance:g}, as near as that allows to a random place around
the mean's parameters (Bardsley et al. 2014, randomize then optimize). Then the joints are stiffened for
thixotropy (below). The population has the covariance of the results, in a space that ends at the bounds of Table
1, around the chain with the published mean itself: the mean of parameters has another response than the mean of
people. Where the references say nothing, the spread of the random places remains ({spread:g} in that space); it
is assumed. Strain stiffening is at its lower bound, and the masses are in proportion to the body's."""

NARROW: Final = 0.02
AT_BOUNDS: Final = """\
Nearly without spread, because at rest or at 1 m/s^2 they lie at a bound of Table 1: {narrow}. So the band of a
prediction is likely too narrow there."""

COMPROMISE: Final = f"""\
Parameters within Table 1 that minimise the squared deviation of the apparent mass (its rms over frequency is in
the table) and, with the given weight, an amplification of the head beyond {MOST:g}."""

COMPROMISE_MEANS: Final = """\
Six segments in series carry the head on top: the larger the resonance of the apparent mass, the more they amplify
the head. Less amplification costs agreement. A mass of 8 to 12 kg on a spring at the torso (the effect `viscera`)
takes over the resonance: the apparent mass then agrees three times better, and the head is amplified less."""

SOFTENING: Final = """\
The resonance of people falls with magnitude. The six segments alone have stiffening only, so their resonance cannot
fall. The effect `thixotropy` lets it fall: a joint softens with recent motion. In the table the stiffness at rest
is raised so that the apparent mass at 1 m/s^2 stays (statistical linearisation). It agrees with both groups if all
joints soften by most of their stiffness, so the population has the effect in all joints: softening {softening:g},
rate {rate_mps:g} m/s, {tau_s:g} s."""

LIMITS: Final = """\
- No person was recorded here. The references are groups in laboratories under vertical vibration; the magnitude for the
  60 people could not be read, and is taken as 1 m/s^2.
- The band of a new subject is the spread between people. What the model itself misses is not in it.
- Stature has no influence. Outside 40 to 120 kg and 1.4 to 2.0 m the subject is marked as extrapolated, with a
  warning."""

COVERED: Final = f"""\
Percent of drawn people within the 95 % interval of the mean's prediction, all segments together, by motion: roads,
shocks, and sine vibration of {SINE_RMS_MPS2:g} m/s^2 rms. Roads and shocks have {len(SEEDS)} realisations each, which
share the people. The band is of second order along each step of the parameters; peaks are those of each chain."""

SHARE: Final = 90.0
COVERAGE: Final = (90.0, 98.0)
DRAWN: Final = 200
SPREAD_DRAWN: Final = 20_000
"""For the spread of parameters, which needs no simulation: standard deviations are within 1 % of their limit."""

SHOWN_HZ: Final = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0)


@dataclass(frozen=True, eq=False)
class Study:
    """All results: the mean subject and those of the paper beside the groups, coverage, compromises and softening."""

    population: Population
    subjects: Sequence[BesidePeople]
    covered: Coverage
    compromises: Sequence[HeadRow]
    softened: Sequence[SofteningRow]

    @property
    def mean(self) -> BesidePeople:
        """The mean subject."""
        return self.subjects[0]


def marks(study: Study) -> list[Mark]:
    """All requirements."""
    shares = dict(zip(("modulus", "phase"), study.mean.share_within(1.0), strict=True))
    found = [
        Mark(
            f"mean of the population: {name} of the apparent mass within one standard deviation, of frequencies",
            f">= {SHARE:g} %", f"{100 * share:.0f} %", 100 * share >= SHARE,
        )
        for name, share in shares.items()
    ]  # fmt: skip
    least, most = COVERAGE
    for motion, names in (("roads and shocks", CASES), ("sine vibration", SINES)):
        for figure, share in averaged(study.covered, names).items():
            what = f"people of the population in the 95 % interval, {motion}: {figure}"
            found.append(Mark(what, f"{least:g} to {most:g} %", f"{share:.1f} %", least <= share <= most))
    for one in study.mean.softened:
        reached = _exponent(one)
        what = f"exponent of resonance over magnitude, {_short(one.published.source)}"
        found.append(Mark(what, f"{one.published.exponent:+.3f}, factor 2", reached, one.agrees))
    head = "mean of the population: transmissibility of the head within one standard deviation"
    return [*found, Mark(head, ">= 80 %", "no published modulus could be read", False)]


def rendered(study: Study, date: str) -> str:
    """The page."""
    parts = [
        HEAD, f"Run of {date}.\n", _marks(study), _references(), _subjects(study.subjects),
        _population(study.population), _covered(study.covered), _head(study.compromises),
        _softening(study.softened, study.population.softening), _limits(),
    ]  # fmt: skip
    return "\n".join(parts).rstrip() + "\n"


def _marks(study: Study) -> str:
    return _section("", mark_table(marks(study)))


def _references() -> str:
    known = references()
    mass, head = known.apparent_mass, known.head
    rows = [
        ["apparent mass, mean", str(mass.people), f"one mass: {mass.natural_frequency_hz:g} Hz, {mass.damping_ratio:g}",
         mass.source],
        *(["resonance over magnitude", str(one.people), _falling(one), one.source] for one in known.softening),
        *(
            ["resonance", str(one.people), f"{one.resonance_hz:g} Hz, {one.magnitude_mps2:g} m/s^2", one.source]
            for one in known.resonances
        ),
        ["head, peak", str(head.people), f"{head.peak_hz:g} Hz", head.source],
    ]  # fmt: skip
    lines = [
        *table(["quantity", "people", "value", "source"], rows), "", REFERENCES, "",
        f"**Spread between people.** {_sentence(mass.assumed_spread.reason)}", "",
        f"**Not confirmed, so not used:** {'; '.join(known.not_confirmed)}.",
    ]  # fmt: skip
    return _section("References", lines)


def _subjects(subjects: Sequence[BesidePeople]) -> str:
    rows = []
    for found in subjects:
        modulus, phase = found.share_within(1.0)
        at_hz, peak = peak_of(found.curves.frequency_hz, np.abs(found.curves.apparent_mass))
        head_hz, head = found.curves.head_peak
        rows.append(
            [
                found.subject.name, f"{100 * modulus:.0f} %", f"{100 * phase:.0f} %", f"{peak:.2f} at {at_hz:.1f} Hz",
                f"{head:.2f} at {head_hz:.1f} Hz", *(_exponent(one) for one in found.softened),
            ]
        )  # fmt: skip
    columns = [
        "subject",
        "modulus within",
        "phase within",
        "peak of apparent mass",
        "peak of head",
        "exponent",
        "exponent",
    ]
    lines = [
        *SUBJECTS, *table(columns, rows), "", SUBJECTS_MEAN,
    ]  # fmt: skip
    return _section("Subjects beside the groups", lines)


def _population(of: Population) -> str:
    drawn = [curves(person_of(theta), MAGNITUDE_MPS2) for theta in of.at_rest.draw(np.random.default_rng(1), DRAWN)]
    frequency_hz = drawn[0].frequency_hz
    band = references().apparent_mass.band(frequency_hz)
    masses = np.array([one.apparent_mass for one in drawn])
    modulus, phase = np.abs(masses), np.degrees(np.angle(masses))
    rows = []
    for at_hz in SHOWN_HZ:
        at = int(np.argmin(np.abs(frequency_hz - at_hz)))
        rows.append(
            [
                f"{at_hz:g}", f"{band.modulus[at]:.2f} ± {band.modulus_sd[at]:.2f}",
                f"{modulus[:, at].mean():.2f} ± {modulus[:, at].std():.2f}",
                f"{band.phase_deg[at]:.0f} ± {band.phase_sd_deg[at]:.0f}",
                f"{phase[:, at].mean():.0f} ± {phase[:, at].std():.0f}",
            ]
        )  # fmt: skip
    how = of.provenance["derivation"]
    narrow = [name for name, one in zip(NAMES, deviations(of.at_rest), strict=True) if one < NARROW]
    lines = [
        POPULATION.format(**how), "",
        *table(["f, Hz", "modulus, group", "modulus, population", "phase, group", "phase, population"], rows), "",
        *parameter_table(of.at_rest), "",
        AT_BOUNDS.format(narrow=", ".join(narrow)),
    ]  # fmt: skip
    return _section("The population", lines)


def deviations(people: Distribution) -> Floats:
    """Standard deviations (13,) of the logarithms of the parameters of drawn people.

    To first order around the mean they would be half as large for some: the space of the draws ends at bounds.
    """
    drawn = people.draw(np.random.default_rng(2), SPREAD_DRAWN)[:, SPREAD]
    return np.asarray(np.log(drawn).std(axis=0))


def parameter_table(people: Distribution) -> list[str]:
    """The lines of the table of the parameters: the mean and the spread of each."""
    mean = theta_of(people.mean)[SPREAD]
    rows = [
        [name, f"{value:.3g}", f"{100 * one:.1f} %"]
        for name, value, one in zip(NAMES, mean, deviations(people), strict=True)
    ]
    return table(["parameter", "mean", f"standard deviation of its logarithm, of {SPREAD_DRAWN:,} drawn people"], rows)


def _covered(coverage: Coverage) -> str:
    figures = list(coverage[SINES[0]])
    rows = [[motion, *(f"{row[figure]:.0f}" for figure in figures)] for motion, row in coverage.items()]
    return _section("Bands of predictions", [COVERED, "", *table(["motion", *figures], rows)])


def _head(found: Sequence[HeadRow]) -> str:
    rows = [
        [
            (one.site or "without").replace("_", " "), f"{one.weight:g}", f"{one.deviation:.3f}", f"{one.peak:.2f}",
            f"{one.peak_hz:g}", ", ".join(f"{value:.2g}" for value in one.viscera) or "-",
        ]
        for one in found
    ]  # fmt: skip
    columns = ["viscera on", "weight", "deviation", "peak of head", "at, Hz", "mass kg, f Hz, damping"]
    lines = [
        COMPROMISE, "", *table(columns, rows), "", COMPROMISE_MEANS,
    ]  # fmt: skip
    return _section("Apparent mass and head together", lines)


def _softening(found: Sequence[SofteningRow], chosen: Mapping[str, float]) -> str:
    rows = [
        [
            one.sites,
            f"{one.softening:g}",
            *(_resonances(each) for each in one.found.softened),
            f"{one.found.curves.head_peak[1]:.2f}",
        ]
        for one in found
    ]
    known = [f"{_short(one.source)}: {one.exponent:+.3f}" for one in references().softening]
    lines = [
        SOFTENING.format(**chosen), "",
        *table(["joints that soften", "softening", *known, "peak of head"], rows),
    ]  # fmt: skip
    return _section("Resonance over magnitude", lines)


def _limits() -> str:
    return _section("Limits", [LIMITS])


def _falling(one: Softening) -> str:
    (low, high), (first, last) = one.magnitudes_mps2, one.resonances_hz
    return f"{first:g} to {last:g} Hz, {low:g} to {high:g} m/s^2"


def _resonances(one: Softened) -> str:
    mark = "" if one.agrees else ", outside"
    low, high = ("none" if each is None else f"{each:.2f}" for each in one.resonances_hz)
    return f"{low} to {high} Hz, {_exponent(one)}{mark}"


def _exponent(one: Softened) -> str:
    """The exponent of a subject, or that it has none without both resonances."""
    return "none" if one.exponent is None else f"{one.exponent:+.3f}"


def _short(source: str) -> str:
    return source.partition(",")[0]


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _section(title: str, lines: Sequence[str]) -> str:
    return "\n".join([*([f"## {title}", ""] if title else []), *lines, ""])
