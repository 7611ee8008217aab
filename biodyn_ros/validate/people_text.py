"""A subject beside published groups of people, as sentences and as text for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from biodyn_core.body.origin import origin_of
from biodyn_core.population.beside import DEVIATIONS, BesidePeople, Outside
from biodyn_core.population.curves import RESONANCE_HZ
from biodyn_core.population.references import references
from biodyn_ros.base.wording import ORIGIN, number

UNITS = {"modulus": "", "phase": " degrees"}


def text_of(found: BesidePeople) -> str:
    """The comparison as text for the terminal."""
    subject, known = found.subject, references()
    lines = [
        f"{subject.name} ({subject.mass_matrix}), parameters {ORIGIN[origin_of(subject)]}",
        f"beside {known.apparent_mass.people} people, {known.apparent_mass.source}",
        "",
        *agreement(found),
        *(f"outside: {sentence_of(one)}" for one in found.outside),
        *softening(found),
        head(found),
        "",
        *cautions(),
    ]
    return "\n".join(lines)


def agreement(found: BesidePeople) -> Iterator[str]:
    """How much of the apparent mass is within one standard deviation of the group's mean."""
    modulus, phase = found.share_within(1.0)
    yield (
        f"apparent mass over that at 0.5 Hz: modulus within one standard deviation at {100 * modulus:.0f} %"
        f" of frequencies, phase at {100 * phase:.0f} %"
    )
    yield f"{_resonance(found.curves.resonance_hz)} at {found.curves.magnitude_mps2:g} m/s^2 rms"


def sentence_of(one: Outside) -> str:
    """A range of frequencies in which the subject lies outside."""
    unit = UNITS[one.quantity]
    return (
        f"{one.quantity} from {one.begin_hz:g} to {one.end_hz:g} Hz: {number(one.value)}{unit} at {one.at_hz:g} Hz,"
        f" {number(one.lower)} to {number(one.upper)}{unit} is mean and {DEVIATIONS:g} standard deviations"
    )


def softening(found: BesidePeople) -> Iterator[str]:
    """How the resonance changes with magnitude, beside each group."""
    for one in found.softened:
        (low, high), (first, last) = one.published.magnitudes_mps2, one.published.resonances_hz
        own, own_last = one.resonances_hz
        if own is not None and own_last is not None:
            changes = f"resonance {number(own)} to {number(own_last)} Hz from {low:g} to {high:g} m/s^2"
        else:
            changes = f"{_resonance(own)} at {low:g} m/s^2, {_resonance(own_last)} at {high:g} m/s^2"
        yield (
            f"{'agrees' if one.agrees else 'outside'}: {changes}, of {one.published.people} people"
            f" {first:g} to {last:g} Hz ({one.published.source})"
        )


def _resonance(frequency_hz: float | None) -> str:
    """A resonance, or that there is none in the band in which it is searched."""
    least_hz, most_hz = RESONANCE_HZ
    if frequency_hz is None:
        return f"no resonance from {least_hz:g} to {most_hz:g} Hz"
    return f"resonance {number(frequency_hz)} Hz"


def head(found: BesidePeople) -> str:
    """The peak of the head, which cannot be judged."""
    frequency_hz, value = found.curves.head_peak
    known = references().head
    return (
        f"not judged: seat-to-head transmissibility {number(value)} at {number(frequency_hz)} Hz;"
        f" of {known.people} people on an elastic seat it peaks near {known.peak_hz:g} Hz;"
        " its modulus could not be read"
    )


def cautions() -> list[str]:
    """What the references do not say."""
    known = references()
    return [
        f"The spread between people is {known.apparent_mass.assumed_spread.reason}.",
        f"Not confirmed in any source: {'; '.join(known.not_confirmed)}.",
    ]
