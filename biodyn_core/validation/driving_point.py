"""Driving point: apparent mass and impedance at the seat, of simulated responses or of the linear model.

No force is measured, so both are of the model alone. Zaman et al., 4.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from biodyn_core.base.arrays import Complexes, Flags, Floats
from biodyn_core.body.model import WARM_UP_S, Chain, Response, SeatForce
from biodyn_core.body.subject import Subject
from biodyn_core.signals.response import common_rate_hz, cross_spectra
from biodyn_core.signals.spectrum_settings import SpectrumSettings


@dataclass(frozen=True, eq=False)
class DrivingPoint:
    """Complex apparent_mass_kg (f,) over frequency_hz (f,), and its coherence (f,).

    Where the seat hardly moves, the coherence is low and the apparent mass invalid. chance_coherence: 1 for a single
    segment, whose coherence is always one, and else 0, because a computed force has no noise.
    body_mass_kg is the whole person's (Eq. 20), upper_body_mass_kg the model's, by which the paper's printed 1.686 and
    2.709 are normalised. form and as_printed: of the force, as in `Chain.seat_force`.
    """

    form: SeatForce
    as_printed: bool
    frequency_hz: Floats
    apparent_mass_kg: Complexes
    coherence: Floats
    chance_coherence: float
    body_mass_kg: float
    upper_body_mass_kg: float

    @property
    def lacks_effects(self) -> bool:
        """Whether the form of the force leaves out what effects add to joint 1, such as thixotropy."""
        return self.form != "inertia"

    def is_coherent(self, least_coherence: float) -> Flags:
        """Flags (f,) of a coherence above the required least and above chance."""
        return np.nan_to_num(self.coherence) > max(self.chance_coherence, least_coherence)

    @property
    def by_body_mass(self) -> Floats:
        """Magnitude over the body's mass, (f,)."""
        return np.abs(self.apparent_mass_kg) / self.body_mass_kg

    @property
    def by_upper_body_mass(self) -> Floats:
        """Magnitude over the mass of the six segments, (f,)."""
        return np.abs(self.apparent_mass_kg) / self.upper_body_mass_kg

    @property
    def phase_deg(self) -> Floats:
        """Phase of the force against the acceleration, (f,) degrees."""
        return np.degrees(np.angle(self.apparent_mass_kg))

    @property
    def impedance_n_s_per_m(self) -> Complexes:
        """Force over the seat's velocity, (f,) N s/m (Eq. 22).

        S_FV / S_VV is 2 pi i f S_FA / S_AA: integration over frequency avoids the drift of a velocity over time.
        """
        return 2j * np.pi * self.frequency_hz * self.apparent_mass_kg


def driving_point(
    subject: Subject,
    responses: Sequence[Response],
    form: SeatForce = "inertia",
    as_printed: bool = False,
    settings: SpectrumSettings | None = None,
) -> DrivingPoint:
    """Apparent mass and impedance of simulated responses, without `WARM_UP_S` of each; options of `Chain.seat_force`.

    Raises InputError as that does, and as `cross_spectra`.
    """
    chain = Chain.of(subject)
    rate_hz = common_rate_hz([response.rate_hz for response in responses])
    parts = []
    for response in responses:
        begin = round(WARM_UP_S * rate_hz)
        parts.append((response.seat_mps2[begin:], chain.seat_force(response, form, as_printed)[begin:, None]))
    found = cross_spectra(parts, rate_hz, settings)
    return DrivingPoint(
        form=form,
        as_printed=as_printed,
        frequency_hz=found.frequency_hz,
        apparent_mass_kg=found.h1[:, 0],
        coherence=found.coherence[:, 0],
        chance_coherence=float(found.segments[0] == 1),
        body_mass_kg=subject.body_mass_kg,
        upper_body_mass_kg=float(chain.mass_kg.sum()),
    )


def linear_driving_point(
    subject: Subject, frequency_hz: Floats, form: SeatForce = "inertia", as_printed: bool = False
) -> DrivingPoint:
    """The same of the linear model (s_nl = 0), exactly."""
    chain = Chain.of(subject)
    return DrivingPoint(
        form=form,
        as_printed=as_printed,
        frequency_hz=frequency_hz,
        apparent_mass_kg=chain.apparent_mass(frequency_hz, form, as_printed),
        coherence=np.ones(frequency_hz.size),
        chance_coherence=0.0,
        body_mass_kg=subject.body_mass_kg,
        upper_body_mass_kg=float(chain.mass_kg.sum()),
    )
