"""Diagnostics: what the residual says after the refit of theta, before any candidate is tried (tracing, A)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import optimize, signal

from biodyn_core.base.arrays import Complexes, Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import at_bound
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.findings import Diagnostics
from biodyn_core.tracing.gate import pulled_down
from biodyn_core.tracing.nuisance_model import FREE, N_THETA, Background
from biodyn_core.tracing.rows import Products

BAND_HZ: Final = (0.5, 60.0)
COHERENCE_S: Final = 2.0
"""Windows of the coherence."""

REACH: Final = float(np.log(100.0))
"""A joint of a sub-chain is looked for so far from the subject's own, in ln of stiffness and damping."""

FAILS: Final = 2.0
"""A sub-chain fails whose error is so many times that of the best one."""


def diagnose(subject: Subject, background: Background) -> Diagnostics:
    """Look at what a fitted subject leaves in the events it was fitted to."""
    cases = background.train.cases
    missed = [np.where(case.compared, case.measured_mps2 - answer(subject, case), 0.0) for case in cases]
    peeled = peeling(subject, cases)
    return Diagnostics(
        amplitude_transfer=_amplitude_transfer(background),
        coherent=coherent(cases, missed),
        peeling=peeled,
        bracket=bracket(peeled),
        level_slope=_level_slope(cases, missed),
        jump=_jump(background),
        pinned=at_bound(subject.parameters.vector(), FREE),
        drift=_drift(background),
        pulled_down=max(pulled_down(subject, case) for case in cases),
    )


def coherent(cases: Sequence[Case], missed: Sequence[Floats]) -> Mapping[str, tuple[str, float]]:
    """Per channel, the segment whose residual goes most with it, and the share of power, less what chance gives.

    Chance: the same with the channel shifted by half its length.
    """
    names = sorted(set.intersection(*(set(case.channels) for case in cases)))
    channels = {f"{SEAT}.z": [case.seat_mps2 for case in cases]}
    channels |= {name: [case.channels[name] for case in cases] for name in names}
    windowed = [_windowed(one, case) for one, case in zip(missed, cases, strict=True)]
    found = {}
    for name, columns in channels.items():
        shifted = [np.roll(column, len(column) // 2) for column in columns]
        share, chance = (
            _share([_windowed(c[:, None], case) for c, case in zip(drive, cases, strict=True)], windowed)
            for drive in (columns, shifted)
        )
        best = int(np.argmax(share - chance))
        found[name] = (MEASURED_SEGMENTS[best], max(float((share - chance)[best]), 0.0))
    return found


def _windowed(values: Floats, case: Case) -> Complexes:
    """Spectra (w, f, k) within the band of half-overlapping windows of 2 s of values (n, k), behind the warm-up."""
    length = min(round(COHERENCE_S * case.rate_hz), len(values) - case.begin)
    parts = np.lib.stride_tricks.sliding_window_view(np.nan_to_num(values[case.begin :]), length, axis=0)
    spectra = np.fft.rfft(parts[:: length // 2] * signal.windows.hann(length), axis=2)
    frequency_hz = np.fft.rfftfreq(length, 1.0 / case.rate_hz)
    inside = np.flatnonzero((frequency_hz >= BAND_HZ[0]) & (frequency_hz <= BAND_HZ[1]))
    return np.asarray(spectra[:, :, inside].transpose(0, 2, 1))


def _share(drive: Sequence[Complexes], residual: Sequence[Complexes]) -> Floats:
    """The share of each segment's power (5,) that goes linearly with a channel, over all events."""
    grid = min(part.shape[1] for part in drive)
    x = np.concatenate([part[:, :grid] for part in drive])
    y = np.concatenate([part[:, :grid] for part in residual])
    cross, square, power = (np.conj(x) * y).sum(axis=0), (np.abs(x) ** 2).sum(axis=0), (np.abs(y) ** 2).sum(axis=0)
    along = (np.abs(cross) ** 2 / np.maximum(square, 1e-30)).sum(axis=0)
    return np.asarray(along / np.maximum(power.sum(axis=0), 1e-30))


def peeling(subject: Subject, cases: Sequence[Case]) -> dict[str, float]:
    """Error (% of rms) of the top of each sub-chain, driven by what was measured below it and its own joints refitted.

    From the head down: the head on the neck, the head on the upper torso, ... on the seat. Linear, in the frequency
    domain, about the subject's own joints; the central torso, which nobody measures, moves as the chain has it.
    """
    chain = Chain.of(subject)
    spectra = [_spectra(case) for case in cases]
    found = {}
    for below in range(len(MEASURED_SEGMENTS) - 1, -1, -1):
        bottom = 0 if below == 0 else int(MEASURED_SEGMENT_INDEX[below - 1]) + 1
        joints = slice(bottom, len(SEGMENTS))
        start = np.log(np.concatenate([chain.stiffness_n_per_m[joints], chain.damping_n_s_per_m[joints]]))
        node = SEAT if below == 0 else MEASURED_SEGMENTS[below - 1]
        driven = [one for one in spectra if below == 0 or one[2][below - 1] > 0.0]
        seen = [(f, spectrum[:, below], spectrum[:, below + 1 :], weight) for f, spectrum, weight in driven]
        told = sum(int((weight[below:] > 0.0).sum()) for _, _, weight in driven)
        if not told:  # nothing is measured above or below
            continue
        sub = _SubChain(bottom, chain.inertia_kg[bottom:], chain.rayleigh_rad_per_s, seen)
        best = optimize.least_squares(sub.missed, start, bounds=(start - REACH, start + REACH), max_nfev=12)
        found[node] = float(100.0 * np.sqrt(2.0 * best.cost / told))
    return found


def bracket(peeled: Mapping[str, float]) -> tuple[str, ...]:
    """The joints between the last sub-chain that holds, from the head down, and the first that fails; () where none."""
    nodes = list(peeled)
    errors = np.array([peeled[node] for node in nodes])
    fails = np.flatnonzero(errors > FAILS * errors.min())
    fails = fails[fails > int(np.argmin(errors))] if fails.size and fails[0] > int(np.argmin(errors)) else fails
    if fails.size == 0:
        return ()
    node = nodes[int(fails[0])]
    bottom = 0 if node == SEAT else SEGMENTS.index(node) + 1
    above = nodes[int(fails[0]) - 1] if fails[0] else SEGMENTS[-1]
    return tuple(SEGMENTS[bottom : SEGMENTS.index(above) + 1])


@dataclass(frozen=True, eq=False)
class _SubChain:
    """The masses from `bottom` up, driven by what was measured below; seen: frequencies, drive, above and weights."""

    bottom: int
    inertia_kg: Floats
    alpha_r: float
    seen: Sequence[tuple[Floats, Complexes, Complexes, Floats]]

    def missed(self, point: Floats) -> Floats:
        """What the sub-chain misses for logarithms of its stiffnesses and dampings (2 n,)."""
        k, b = np.exp(np.split(point, 2))
        at = MEASURED_SEGMENT_INDEX[self.bottom <= MEASURED_SEGMENT_INDEX] - self.bottom
        parts = []
        for frequency_hz, drive, above, weight in self.seen:
            through = _transmitted(frequency_hz, k, b, self.inertia_kg, self.alpha_r)[:, at]
            parts.append(((through * drive[:, None] - above) * weight[-above.shape[1] :]).ravel())
        flat = np.concatenate(parts)
        return np.concatenate([flat.real, flat.imag])


def _spectra(case: Case) -> tuple[Floats, Complexes, Floats]:
    """Frequencies (f,), spectra (f, 6) of the seat and the five sensors, and weights (5,), one over a sensor's size."""
    used = np.where(case.energy > 0.0, case.measured_mps2, 0.0)
    whole = np.column_stack([case.seat_mps2, used])[case.begin :]
    spectrum = np.fft.rfft(whole * signal.windows.tukey(len(whole), 0.1)[:, None], axis=0)
    frequency_hz = np.fft.rfftfreq(len(whole), 1.0 / case.rate_hz)
    inside = (frequency_hz >= BAND_HZ[0]) & (frequency_hz <= BAND_HZ[1])
    spectrum = spectrum[inside]
    energy = np.asarray((np.abs(spectrum[:, 1:]) ** 2).sum(axis=0), dtype=np.float64)
    weight: Floats = np.where(energy > 0.0, 1.0 / np.sqrt(np.where(energy > 0.0, energy, 1.0)), 0.0)
    return np.asarray(frequency_hz[inside], dtype=np.float64), spectrum, weight


def _transmitted(frequency_hz: Floats, k: Floats, b: Floats, inertia_kg: Floats, alpha_r: float) -> Complexes:
    """Transmissibility (f, n) of accelerations from below to each mass of a chain of n."""
    omega = 2.0 * np.pi * frequency_hz
    n = len(k)
    matrix = np.zeros((len(omega), n, n), dtype=np.complex128)
    joint = k + 1j * omega[:, None] * b
    for i in range(n):
        matrix[:, i, i] += joint[:, i] - omega**2 * inertia_kg[i] + 1j * omega * alpha_r * inertia_kg[i]
        if i + 1 < n:
            matrix[:, i, i] += joint[:, i + 1]
            matrix[:, i, i + 1] -= joint[:, i + 1]
            matrix[:, i + 1, i] -= joint[:, i + 1]
    # Relative to what is below: M u'' + C u' + K u = -M a, T = 1 - omega^2 u / a.
    load = np.broadcast_to(-inertia_kg[:, None].astype(np.complex128), (len(omega), n, 1))
    return np.asarray(1.0 - omega[:, None] ** 2 * np.linalg.solve(matrix, load)[:, :, 0])


def _by_case(background: Background) -> dict[str, Flags]:
    """Which windows of the fitted side are of which loading condition."""
    cases, event = background.train.cases, background.train.products.event
    names = list(dict.fromkeys(case.case for case in cases))
    return {name: np.isin(event, [i for i, case in enumerate(cases) if case.case == name]) for name in names}


def _theta_of(background: Background, windows: Flags) -> Floats:
    """The linear step of theta (14,) that these windows alone ask for."""
    p, weight = background.train.products, np.where(windows, background.weight, 0.0)
    normal = np.einsum("w,wij->ij", weight, p.columns[:, :N_THETA, :N_THETA])
    return np.linalg.solve(normal + np.diag(background.precision[:N_THETA]), weight @ p.miss[:, :N_THETA])


def _left_by(p: Products, windows: Flags, theta: Floats) -> float:
    b = np.concatenate([theta, np.zeros(p.miss.shape[1] - N_THETA)])
    return float(np.sqrt(p.left(b)[windows].sum() / max(p.samples[windows].sum(), 1.0)))


def _amplitude_transfer(background: Background) -> dict[str, tuple[float, float]]:
    """Per condition, what theta of the quietest alone leaves, and theta of all, in what a good model misses."""
    by_case, p = _by_case(background), background.train.products
    loud = {
        name: np.mean([np.abs(case.seat_mps2).max() for case in background.train.cases if case.case == name])
        for name in by_case
    }
    quiet = _theta_of(background, by_case[min(loud, key=lambda name: loud[name])])
    everything = _theta_of(background, np.ones(p.square.size, dtype=bool))
    return {name: (_left_by(p, w, quiet), _left_by(p, w, everything)) for name, w in by_case.items()}


def _drift(background: Background) -> dict[str, float]:
    """Per parameter, how far its values by the conditions alone are apart, ln of the largest over the smallest."""
    found = np.array([_theta_of(background, windows) for windows in _by_case(background).values()])
    names = [p.name for p, free in zip(PARAMETERS, FREE, strict=True) if free]
    return dict(zip(names, (found.max(axis=0) - found.min(axis=0)).tolist(), strict=True))


def _level_slope(cases: Sequence[Case], missed: Sequence[Floats]) -> float | None:
    """Slope of ln(relative residual) over ln(peak of the seat) of the events; None where the peaks are alike."""
    peak = np.log([np.abs(case.seat_mps2).max() for case in cases])
    size = [
        np.sqrt((one[case.compared] ** 2).sum() / max(case.energy.sum(), 1e-9))
        for case, one in zip(cases, missed, strict=True)
    ]
    if len(cases) < 3 or np.ptp(peak) < 0.3:
        return None
    return float(np.polyfit(peak, np.log(np.maximum(size, 1e-12)), 1)[0])


def _jump(background: Background) -> tuple[str, float] | None:
    """Where the residual's size changes most (CUSUM of log squares over windows), and how often a shuffle does more."""
    p = background.train.products
    if p.square.size < 8:
        return None
    score = np.log(np.maximum(p.left(background.solved(p)), 1e-12) / np.maximum(p.samples, 1.0))
    score = score - score.mean()
    walk = np.abs(np.cumsum(score))
    rng = np.random.default_rng(0)
    shuffled = [np.abs(np.cumsum(rng.permutation(score))).max() for _ in range(200)]
    at = int(np.argmax(walk))
    chance = (1.0 + sum(one >= walk[at] for one in shuffled)) / 201.0
    first = min(at + 1, score.size - 1)  # the sum turns with the last window of what was before
    return background.train.cases[int(p.event[first])].name, chance
