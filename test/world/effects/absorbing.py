"""The share of a hidden effect that remains after a refit: a linear refit of the simulation around the true theta.

It looks at one event of each case and does not move far from the truth, so it sees more than a whole refit leaves: in
four sittings 1.3 to 1.7 times as much. It is for choosing strengths; a scorer refits, with and without.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from world import body, ride, sensors
from world.effects import event, wearing
from world.effects.effect import WORN, Effect, Person
from world.effects.moving import Party, moved, runs_away

if TYPE_CHECKING:
    from world.effects.sitting import Sitting

Floats = NDArray[np.float64]

FREE: Final = 14
"""Parameters that accelerations determine; m_scale cancels."""

STEP: Final = 0.01
LOW_PASS_HZ: Final = 100.0
EVERY: Final = 8
NOISE_MPS2: Final = sensors.NOISE_MPS2 * np.sqrt(2.0 * LOW_PASS_HZ / sensors.RATE_HZ)
"""Rms of the noise after the low-pass."""

PASSES: Final = 2
"""Corrections of the strengths by the ratio they leave."""


def scaled(sittings: Sequence[Sitting], wanted: Sequence[float]) -> list[Sitting]:
    """The sittings with effects so strong that they leave about the wanted ratios, and with the ratios they do leave.

    Strengths stay between a tenth of the least and three times the most that their form is drawn with.
    """
    found, calm = list(sittings), list(sittings)
    seen = _Seen(sittings)
    for turn in range(PASSES + 1):
        for i, ratio in enumerate(seen.ratios(found)):
            if np.isfinite(ratio):
                calm[i] = dataclasses.replace(found[i], ratio=ratio)
            elif calm[i].ratio is not None:
                found[i] = calm[i]  # and no weaker: a law may be the stiffer the weaker it is
                continue
            if turn < PASSES:
                factor = float(np.clip(wanted[i] / max(ratio, 1e-3), 0.1, 10.0))
                found[i] = dataclasses.replace(found[i], effects=tuple(_limited(e, factor) for e in found[i].effects))
    return calm


def scaled_once(sittings: Sequence[Sitting], wanted: Sequence[float]) -> list[Sitting]:
    """As `scaled` by one simulation, as if ratios were proportional to strengths: for many bodies, where speed counts.

    Each has the ratio that is expected of its strength.
    """
    found = []
    for one, ratio, aim in zip(sittings, ratios(sittings), wanted, strict=True):
        factor = float(np.clip(aim / max(ratio, 1e-3), 0.1, 10.0)) if np.isfinite(ratio) else 0.1
        effects = tuple(_limited(effect, factor) for effect in one.effects)
        given = max((new.strength / old.strength for new, old in zip(effects, one.effects, strict=True)), default=1.0)
        found.append(dataclasses.replace(one, effects=effects, ratio=ratio * given if np.isfinite(ratio) else None))
    return found


def ratios(sittings: Sequence[Sitting]) -> list[float]:
    """Rms of (residual with effects minus residual without) over rms without; one event of each case."""
    return _Seen(sittings).ratios(sittings)


def _limited(effect: Effect, factor: float) -> Effect:
    if not effect.scalable:
        return effect
    low, high = effect.strengths
    return dataclasses.replace(effect, strength=float(np.clip(effect.strength * factor, 0.1 * low, 3.0 * high)))


class _Seen:
    """Quantities that do not depend on strengths: the residual of the background, and the directions of theta."""

    def __init__(self, sittings: Sequence[Sitting]) -> None:
        from world.effects.sitting import first_of_each

        self.few = [dataclasses.replace(one, events=first_of_each(one.events)) for one in sittings]
        models = [Party(person, one.party(()).events) for one in self.few for person in _around(one)]
        went = moved([*(one.party(()) for one in self.few), *models])
        self.plain, self.absorbed, self.residual = [], [], []
        for i, one in enumerate(self.few):
            first = len(self.few) + i * (FREE + 1)
            plain = _heard(one, went[i].accel_mps2, ())
            model, *beside = (
                np.concatenate([_thinned(accel[:, at - 1]) for accel in m.accel_mps2 for at in _worn(one)])
                for m in went[first : first + FREE + 1]
            )
            weight = np.concatenate([np.full(part.size, 1.0 / part.std()) for part in np.split(model, _ends(one))])
            base = np.linalg.qr(np.column_stack([(w - model) * weight for w in beside]))[0]
            residual = _without(base, (plain - model) * weight)
            self.plain.append((plain, weight))
            self.absorbed.append(base)
            self.residual.append(float(residual @ residual + ((NOISE_MPS2 * weight) ** 2).sum()))

    def ratios(self, sittings: Sequence[Sitting]) -> list[float]:
        """As the module's, for the same sittings under any effects; infinite for a body that runs away."""
        now = [dataclasses.replace(few, effects=one.effects) for few, one in zip(self.few, sittings, strict=True)]
        found = []
        for i, (one, went) in enumerate(zip(now, moved([one.party(one.effects) for one in now]), strict=True)):
            if runs_away(went.accel_mps2):
                found.append(np.inf)
                continue
            plain, weight = self.plain[i]
            own = _without(self.absorbed[i], (_heard(one, went.accel_mps2, one.effects) - plain) * weight)
            found.append(float(np.sqrt(own @ own / self.residual[i])))
        return found


def _heard(one: Sitting, accel_mps2: Sequence[Floats], effects: Sequence[Effect]) -> Floats:
    """Upward readings of the sensors on the body without noise: events, then sensors, in one vector."""
    parts: list[Floats] = []
    changes = (*one.mechanisms, *effects)
    for planned, accel in zip(one.events, accel_mps2, strict=True):
        time_s = np.arange(len(accel)) / event.HELD_HZ
        for at in _worn(one):
            force, _ = wearing.sensed(at, planned.event, accel[:, at - 1], changes, one.background)
            late_s = one.background.late_s[at] + sum(e.clock_late_s(at, planned.event, time_s) for e in changes)
            up = np.interp(time_s - late_s, time_s, force[:, 2])
            for effect in changes:
                up = effect.reading(at, up)
            parts.append(_thinned(up - sensors.GRAVITY_MPS2))
    return np.concatenate(parts)


def _thinned(values: Floats) -> Floats:
    """Low-passed as a recorder does it, and every so many of them."""
    sos = signal.butter(4, LOW_PASS_HZ, fs=event.HELD_HZ, output="sos")
    return signal.sosfiltfilt(sos, values)[::EVERY]


def _worn(one: Sitting) -> list[int]:
    """The places of the sensors that the body wears."""
    return [at for at in WORN if ride.SENSORS[at] in one.worn]


def _ends(one: Sitting) -> NDArray[np.int64]:
    """Where the next sensor or event begins in such a vector."""
    counts = [-(-len(planned.event.accel_mps2[::2]) // EVERY) for planned in one.events]
    return np.cumsum(np.repeat(counts, len(_worn(one))))[:-1]


def _without(base: Floats, values: Floats) -> Floats:
    return values - base @ (base.T @ values)


def _around(one: Sitting) -> list[Person]:
    """The plain model at the true theta, and with one parameter after the other a little larger."""
    theta = np.tile(one.theta, (FREE + 1, 1))
    theta[np.arange(1, FREE + 1), np.arange(FREE)] *= 1.0 + STEP
    cascade = np.full(FREE + 1, one.mass_matrix == "cascade")
    people = body.People(theta, np.full(FREE + 1, one.body_mass_kg), cascade)
    return [Person.of(people, i) for i in range(FREE + 1)]
