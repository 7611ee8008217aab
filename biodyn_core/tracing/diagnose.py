"""Diagnostics of the residual after the refit of theta, before any candidate is tried."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from biodyn_core.base.arrays import Complexes, Flags, Floats
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX, MEASURED_SEGMENTS, SEAT, SEGMENTS
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import PARAMETERS
from biodyn_core.body.subject import Subject
from biodyn_core.identification.fit import at_bound
from biodyn_core.identification.problem import Case
from biodyn_core.tracing.answers import answer
from biodyn_core.tracing.data_checks import seat_tension
from biodyn_core.tracing.findings import Diagnostics
from biodyn_core.tracing.nuisance_model import FREE, N_THETA, NuisanceModel
from biodyn_core.tracing.rows import Products
from biodyn_core.tracing.settings import DiagnosticSettings


def diagnose(subject: Subject, nuisance: NuisanceModel, settings: DiagnosticSettings | None = None) -> Diagnostics:
    """Diagnostics of the residual of a fitted subject in the events for fitting."""
    s = settings or DiagnosticSettings()
    cases = nuisance.train.cases
    residuals = [np.where(case.compared, case.measured_mps2 - answer(subject, case), 0.0) for case in cases]
    peeled = peeling(subject, cases, s)
    return Diagnostics(
        amplitude_transfer=_amplitude_transfer(nuisance),
        coherent=coherent(cases, residuals, s),
        peeling=peeled,
        bracket=bracket(peeled, s.failing),
        level_slope=_level_slope(cases, residuals, s),
        jump=_jump(nuisance, s),
        at_bound=at_bound(subject.parameters.vector(), FREE),
        drift=_drift(nuisance),
        seat_tension=max(seat_tension(subject, case) for case in cases),
    )


def coherent(
    cases: Sequence[Case], residuals: Sequence[Floats], settings: DiagnosticSettings | None = None
) -> Mapping[str, tuple[str, float]]:
    """Per channel, the segment with the most coherent residual, and its coherent share of power above chance.

    Chance is the share for the channel shifted by half its length.
    """
    s = settings or DiagnosticSettings()
    names = sorted(set.intersection(*(set(case.channels) for case in cases)))
    channels = {f"{SEAT}.z": [case.seat_mps2 for case in cases]}
    channels |= {name: [case.channels[name] for case in cases] for name in names}
    windowed = [_windowed(one, case, s) for one, case in zip(residuals, cases, strict=True)]
    found = {}
    for name, columns in channels.items():
        shifted = [np.roll(column, len(column) // 2) for column in columns]
        share, chance = (
            _share([_windowed(c[:, None], case, s) for c, case in zip(drive, cases, strict=True)], windowed)
            for drive in (columns, shifted)
        )
        best = int(np.argmax(share - chance))
        found[name] = (MEASURED_SEGMENTS[best], max(float((share - chance)[best]), 0.0))
    return found


def _windowed(values: Floats, case: Case, s: DiagnosticSettings) -> Complexes:
    """Spectra (w, f, k) within the band of half-overlapping windows of values (n, k), after the warm-up."""
    length = min(round(s.coherence_s * case.rate_hz), len(values) - case.begin)
    parts = np.lib.stride_tricks.sliding_window_view(np.nan_to_num(values[case.begin :]), length, axis=0)
    spectra = np.fft.rfft(parts[:: length // 2] * scipy.signal.windows.hann(length), axis=2)
    frequency_hz = np.fft.rfftfreq(length, 1.0 / case.rate_hz)
    inside = np.flatnonzero((frequency_hz >= s.band_hz[0]) & (frequency_hz <= s.band_hz[1]))
    return np.asarray(spectra[:, :, inside].transpose(0, 2, 1))


def _share(drive: Sequence[Complexes], residual: Sequence[Complexes]) -> Floats:
    """The share of each segment's power (5,) that is coherent with a channel, over all events."""
    grid = min(part.shape[1] for part in drive)
    x = np.concatenate([part[:, :grid] for part in drive])
    y = np.concatenate([part[:, :grid] for part in residual])
    cross, square, power = (np.conj(x) * y).sum(axis=0), (np.abs(x) ** 2).sum(axis=0), (np.abs(y) ** 2).sum(axis=0)
    along = (np.abs(cross) ** 2 / np.maximum(square, 1e-30)).sum(axis=0)
    return np.asarray(along / np.maximum(power.sum(axis=0), 1e-30))


def peeling(subject: Subject, cases: Sequence[Case], settings: DiagnosticSettings | None = None) -> dict[str, float]:
    """Error (% of rms) of the segments above each sensor, driven by its measurement, with their joints refitted.

    From the head down: the head on the neck, the head on the upper torso, ... on the seat. Linear, in the frequency
    domain, around the subject's own joints; the central torso has no sensor and follows the chain.
    """
    chain = Chain.of(subject)
    s = settings or DiagnosticSettings()
    spectra = [_spectra(case, s.band_hz) for case in cases]
    range_of_log = float(np.log(s.most_joint_ratio))
    found = {}
    for below in range(len(MEASURED_SEGMENTS) - 1, -1, -1):
        bottom = 0 if below == 0 else int(MEASURED_SEGMENT_INDEX[below - 1]) + 1
        joints = slice(bottom, len(SEGMENTS))
        start = np.log(np.concatenate([chain.stiffness_n_per_m[joints], chain.damping_n_s_per_m[joints]]))
        node = SEAT if below == 0 else MEASURED_SEGMENTS[below - 1]
        driven = [one for one in spectra if below == 0 or one[2][below - 1] > 0.0]
        seen = [(f, spectrum[:, below], spectrum[:, below + 1 :], weight) for f, spectrum, weight in driven]
        compared = sum(int((weight[below:] > 0.0).sum()) for _, _, weight in driven)
        if not compared:
            continue
        sub = _SubChain(bottom, chain.inertia_kg[bottom:], chain.rayleigh_rad_per_s, seen)
        bounds = (start - range_of_log, start + range_of_log)
        best = scipy.optimize.least_squares(sub.residual, start, bounds=bounds, max_nfev=s.joint_evaluations)
        found[node] = float(100.0 * np.sqrt(2.0 * best.cost / compared))
    return found


def bracket(peeled: Mapping[str, float], failing: float) -> tuple[str, ...]:
    """The joints between the last good sub-chain, from the head down, and the first failing one; () if none fails.

    failing: a sub-chain fails if its error exceeds that of the best one by this factor.
    """
    nodes = list(peeled)
    errors = np.array([peeled[node] for node in nodes])
    fails = np.flatnonzero(errors > failing * errors.min())
    fails = fails[fails > int(np.argmin(errors))] if fails.size and fails[0] > int(np.argmin(errors)) else fails
    if fails.size == 0:
        return ()
    node = nodes[int(fails[0])]
    bottom = 0 if node == SEAT else SEGMENTS.index(node) + 1
    above = nodes[int(fails[0]) - 1] if fails[0] else SEGMENTS[-1]
    return tuple(SEGMENTS[bottom : SEGMENTS.index(above) + 1])


@dataclass(frozen=True, eq=False)
class _SubChain:
    """The masses from `bottom` up, driven by the sensor below; seen: frequencies, drive, spectra above, and weights."""

    bottom: int
    inertia_kg: Floats
    alpha_r: float
    seen: Sequence[tuple[Floats, Complexes, Complexes, Floats]]

    def residual(self, point: Floats) -> Floats:
        """The residual of the sub-chain for logarithms of its stiffnesses and dampings (2 n,)."""
        k, b = np.exp(np.split(point, 2))
        at = MEASURED_SEGMENT_INDEX[self.bottom <= MEASURED_SEGMENT_INDEX] - self.bottom
        parts = []
        for frequency_hz, drive, above, weight in self.seen:
            through = _transmitted(frequency_hz, k, b, self.inertia_kg, self.alpha_r)[:, at]
            parts.append(((through * drive[:, None] - above) * weight[-above.shape[1] :]).ravel())
        flat = np.concatenate(parts)
        return np.concatenate([flat.real, flat.imag])


def _spectra(case: Case, band_hz: tuple[float, float]) -> tuple[Floats, Complexes, Floats]:
    """Frequencies (f,), spectra (f, 6) of the seat and the five sensors, and weights (5,), one over a sensor's rms."""
    used = np.where(case.energy > 0.0, case.measured_mps2, 0.0)
    whole = np.column_stack([case.seat_mps2, used])[case.begin :]
    spectrum = np.fft.rfft(whole * scipy.signal.windows.tukey(len(whole), 0.1)[:, None], axis=0)
    frequency_hz = np.fft.rfftfreq(len(whole), 1.0 / case.rate_hz)
    inside = (frequency_hz >= band_hz[0]) & (frequency_hz <= band_hz[1])
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
    # Relative to the drive: M u'' + C u' + K u = -M a, T = 1 - omega^2 u / a.
    load = np.broadcast_to(-inertia_kg[:, None].astype(np.complex128), (len(omega), n, 1))
    return np.asarray(1.0 - omega[:, None] ** 2 * np.linalg.solve(matrix, load)[:, :, 0])


def _by_case(nuisance: NuisanceModel) -> dict[str, Flags]:
    """The windows for fitting by loading condition."""
    cases, event = nuisance.train.cases, nuisance.train.products.event
    names = list(dict.fromkeys(case.case for case in cases))
    return {name: np.isin(event, [i for i, case in enumerate(cases) if case.case == name]) for name in names}


def _theta_of(nuisance: NuisanceModel, windows: Flags) -> Floats:
    """The linear step of theta (14,) by these windows alone."""
    p, weight = nuisance.train.products, np.where(windows, nuisance.weight, 0.0)
    normal = np.einsum("w,wij->ij", weight, p.columns[:, :N_THETA, :N_THETA])
    return np.linalg.solve(normal + np.diag(nuisance.precision[:N_THETA]), weight @ p.cross[:, :N_THETA])


def _residual_with(p: Products, windows: Flags, theta: Floats) -> float:
    b = np.concatenate([theta, np.zeros(p.cross.shape[1] - N_THETA)])
    return float(np.sqrt(p.residual_square(b)[windows].sum() / max(p.samples[windows].sum(), 1.0)))


def _amplitude_transfer(nuisance: NuisanceModel) -> dict[str, tuple[float, float]]:
    """Per condition, the residual with theta of the quietest one and of all, in multiples of a good model's."""
    by_case, p = _by_case(nuisance), nuisance.train.products
    loud = {
        name: np.mean([np.abs(case.seat_mps2).max() for case in nuisance.train.cases if case.case == name])
        for name in by_case
    }
    quiet = _theta_of(nuisance, by_case[min(loud, key=lambda name: loud[name])])
    everything = _theta_of(nuisance, np.ones(p.square.size, dtype=bool))
    return {name: (_residual_with(p, w, quiet), _residual_with(p, w, everything)) for name, w in by_case.items()}


def _drift(nuisance: NuisanceModel) -> dict[str, float]:
    """Per parameter, ln of the largest over the smallest value among fits to single conditions."""
    found = np.array([_theta_of(nuisance, windows) for windows in _by_case(nuisance).values()])
    names = [p.name for p, free in zip(PARAMETERS, FREE, strict=True) if free]
    return dict(zip(names, (found.max(axis=0) - found.min(axis=0)).tolist(), strict=True))


def _level_slope(cases: Sequence[Case], residuals: Sequence[Floats], s: DiagnosticSettings) -> float | None:
    """Slope of ln(relative residual) over ln(peak of the seat) of the events; None if the peaks are similar."""
    peak = np.log([np.abs(case.seat_mps2).max() for case in cases])
    size = [
        np.sqrt((one[case.compared] ** 2).sum() / max(case.energy.sum(), 1e-9))
        for case, one in zip(cases, residuals, strict=True)
    ]
    if len(cases) < s.least_slope_events or np.ptp(peak) < s.least_slope_range:
        return None
    return float(np.polyfit(peak, np.log(np.maximum(size, 1e-12)), 1)[0])


def _jump(nuisance: NuisanceModel, s: DiagnosticSettings) -> tuple[str, float] | None:
    """The event at which the residual changes most (CUSUM of log squares by window), and its p-value by shuffling.

    Windows are in the order of time: events may be given in another one, such as that of dealing.
    """
    p = nuisance.train.products
    if p.square.size < s.least_jump_windows:
        return None
    begins_ns = np.array([case.begins_ns for case in nuisance.train.cases])
    order = np.argsort(begins_ns[p.event], kind="stable")
    score = np.log(np.maximum(p.residual_square(nuisance.solution(p)), 1e-12) / np.maximum(p.samples, 1.0))
    score = score[order] - score.mean()
    walk = np.abs(np.cumsum(score))
    rng = np.random.default_rng(0)
    shuffled = [np.abs(np.cumsum(rng.permutation(score))).max() for _ in range(s.shuffles)]
    at = int(np.argmax(walk))
    chance = (1.0 + sum(one >= walk[at] for one in shuffled)) / (1.0 + s.shuffles)
    first = min(at + 1, score.size - 1)  # the sum turns at the last window before the change
    return nuisance.train.cases[int(p.event[order[first]])].name, chance
