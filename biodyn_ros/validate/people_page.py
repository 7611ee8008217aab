"""The page of a subject beside published groups of people."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from biodyn_core.body.origin import origin_of
from biodyn_core.population.beside import DEVIATIONS, BesidePeople
from biodyn_core.population.references import references
from biodyn_ros import __version__
from biodyn_ros.base.files import make_directory, remove
from biodyn_ros.base.json_files import write_json
from biodyn_ros.base.wording import ORIGIN
from biodyn_ros.reports.drawing import BAND_COLOUR, MEASURED_COLOUR, PREDICTED_COLOUR, SOFT_COLOUR, drawn
from biodyn_ros.reports.pages import render, write_drawn
from biodyn_ros.validate.people_document import people_document
from biodyn_ros.validate.people_text import agreement, cautions, head, sentence_of, softening

JSON: Final = "people.json"
PAGE: Final = "people.html"


def write_people(found: BesidePeople, directory: Path, report: bool = True) -> None:
    """Write people.json and people.html; without a report, the page of an earlier run is removed."""
    make_directory(directory)
    write_json(directory / JSON, people_document(found))
    if report:
        write_drawn(directory / PAGE, lambda: people_page(found))
    else:
        remove(directory / PAGE)


def people_page(found: BesidePeople) -> str:
    """The page; raises InputError where jinja2 or matplotlib is missing."""
    known = references()
    softened = [one for one in found.softened if not one.agrees]
    return render(
        "validate_people.html.j2",
        found=found,
        known=known,
        version=__version__,
        origin=ORIGIN[origin_of(found.subject)],
        tone="bad" if found.outside or softened else "good",
        headline="Differs from the groups" if found.outside or softened else "Agrees with the groups",
        agreement=list(agreement(found)),
        outside=[sentence_of(one) for one in found.outside],
        softening=list(softening(found)),
        head=head(found),
        cautions=cautions(),
        deviations=DEVIATIONS,
        curves_svg=drawn(10.4, 3.1, lambda figure: _curves(figure, found)),
    )


def _curves(figure: Any, found: BesidePeople) -> None:
    """Modulus and phase of the apparent mass with the band of the group, the head, and resonance over magnitude."""
    fill: tuple[Callable[[Any, BesidePeople], None], ...] = (_modulus, _phase, _head, _resonance)
    for axes, panel in zip(figure.subplots(1, len(fill)), fill, strict=True):
        panel(axes, found)
        axes.tick_params(length=2.5, width=0.6)


def _banded(axes: Any, found: BesidePeople, mean: Any, sd: Any, value: Any, title: str) -> None:
    frequency_hz = found.band.frequency_hz
    for deviations, shade in ((DEVIATIONS, 0.35), (1.0, 0.55)):
        axes.fill_between(
            frequency_hz, mean - deviations * sd, mean + deviations * sd, color=BAND_COLOUR, alpha=shade, lw=0
        )
    axes.plot(frequency_hz, mean, color=MEASURED_COLOUR, lw=1.4)
    axes.plot(frequency_hz, value, color=PREDICTED_COLOUR, lw=1.4)
    _over_frequency(axes, title)


def _over_frequency(axes: Any, title: str) -> None:
    axes.set_title(title, loc="left", fontweight="bold")
    axes.set_xlabel("frequency, Hz", color=SOFT_COLOUR)
    axes.set_xlim(0.0, 20.0)


def _modulus(axes: Any, found: BesidePeople) -> None:
    of, band = found.curves, found.band
    _banded(axes, found, band.modulus, band.modulus_sd, np.abs(of.apparent_mass), "apparent mass, over 0.5 Hz")
    axes.set_ylim(bottom=0.0)


def _phase(axes: Any, found: BesidePeople) -> None:
    of, band = found.curves, found.band
    phase_deg = np.degrees(np.unwrap(np.angle(of.apparent_mass)))
    _banded(axes, found, band.phase_deg, band.phase_sd_deg, phase_deg, "its phase, degrees")


def _head(axes: Any, found: BesidePeople) -> None:
    axes.plot(found.curves.frequency_hz, np.abs(found.curves.head), color=PREDICTED_COLOUR, lw=1.4)
    axes.axvline(references().head.peak_hz, color=MEASURED_COLOUR, lw=0.9, ls=(0, (1.0, 1.6)))
    _over_frequency(axes, "seat to head")
    axes.set_ylim(bottom=0.0)


def _resonance(axes: Any, found: BesidePeople) -> None:
    for one, mark in zip(found.softened, ("o", "s", "^"), strict=False):
        magnitudes = one.published.magnitudes_mps2
        axes.plot(magnitudes, one.published.resonances_hz, color=MEASURED_COLOUR, lw=1.2, marker=mark, ms=4.0)
        own = [math.nan if each is None else each for each in one.resonances_hz]
        axes.plot(magnitudes, own, color=PREDICTED_COLOUR, lw=1.2, marker=mark, ms=4.0)
    for one in references().resonances:
        axes.plot(one.magnitude_mps2, one.resonance_hz, color=MEASURED_COLOUR, marker="D", ms=4.0)
    axes.set_title("resonance, Hz", loc="left", fontweight="bold")
    axes.set_xlabel("magnitude, m/s² rms", color=SOFT_COLOUR)
    axes.set_ylim(2.0, 8.0)
