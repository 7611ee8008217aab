"""Identification: one swarm on the surrogate, the batched cost, and a whole subject from three recordings."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bench.ode import rk45
from bench.table import Row, render
from biodyn_core.base.segments import MEASURED_SEGMENT_INDEX
from biodyn_core.body.model import Chain
from biodyn_core.body.parameters import LOWER, UPPER
from biodyn_core.body.subject import Subject, load_subject
from biodyn_core.body.synthesis import imu_streams, load_case
from biodyn_core.body.synthesis_settings import CASES, NATIVE_RATE_HZ
from biodyn_core.identification.fit import Fit, fit_cases, fit_joint
from biodyn_core.identification.identify import identify
from biodyn_core.identification.objectives import RegularizationTerm, Surrogate, TimeDomain
from biodyn_core.identification.phase1 import search
from biodyn_core.identification.problem import Case
from biodyn_core.identification.settings import PAPER, FitSettings, SwarmSettings
from biodyn_core.identification.uncertainty import uncertainty
from biodyn_core.kernels.cost import LANES
from biodyn_core.recording.recording import Recorder, Recording
from biodyn_core.signals.spectrum_settings import SpectrumSettings
from biodyn_ros.base.resources import subject_file
from biodyn_ros.work.executors import executor_of
from biodyn_ros.work.tasks import Work

SECONDS = 6.0
"""Length of each case after the warm-up, as in the paper."""
SUBJECTS = 6
REPEATS = 7
FINE = SpectrumSettings(segment_s=4.0, lowest_hz=0.5, highest_hz=50.25)
"""200 frequencies."""


def rows() -> list[Row]:
    """Measure; about three minutes, most of it for the paper's phases and the scaling with subjects."""
    subject = load_subject(subject_file("subject_1"))
    recordings = [_recording(subject, case) for case in CASES]
    cases = [Case.of(recording) for recording in recordings]
    fit_joint(cases[:1], subject, 0)  # compiles
    swarm_s, dense_s = _swarm_s(Case.of(recordings[0], FINE), subject)
    batched_ms, single_ms = _cost_ms(subject)
    with executor_of("processes:2") as two:
        ours_s = _seconds(lambda: _whole(cases, subject, Work(two)))
    paper_s, rk45_s = _paper_s(cases, subject)
    per_case, pooled = (fit_joint(cases, subject, 0, FitSettings(phase1=how)) for how in ("per_case", "pooled"))
    one_worker_s, two_workers_s = (_subjects_s(cases, subject, workers) for workers in (1, 2))
    whole, faster = "whole subject, three cases, two processes", one_worker_s / two_workers_s
    return [
        Row("swarm, 80 x 200 at 200 frequencies", swarm_s, "s", dense_s, "NumPy, dense", "<= 0.5", swarm_s <= 0.5),
        Row(f"cost of 5 s, {LANES} at once", batched_ms, "ms", single_ms, "one by one", "<= 0.05", batched_ms <= 0.05),
        Row(whole, ours_s, "s", paper_s, "the paper's phases in our kernels", "<= 20", ours_s <= 20.0),
        Row(whole, ours_s, "s", rk45_s, "the same in SciPy RK45, extrapolated", "", None),
        Row("objective of all cases, pooled phase 1", pooled.refined.objective, "", per_case.refined.objective,
            "phase 1 per case", "", None),
        Row(f"{SUBJECTS} subjects, two processes", two_workers_s, "s", one_worker_s, "one process", ">= 1.8 x faster",
            faster >= 1.8),
    ]  # fmt: skip


def _whole(cases: list[Case], subject: Subject, work: Work) -> None:
    """The work of `biodyn fit` after reading the bags."""
    found = identify(cases, subject, 0, run=work.run(""))
    uncertainty(found.joint, cases)


def _paper_s(cases: list[Case], subject: Subject) -> tuple[float, float]:
    """Time of both phases as printed, case by case: in our kernels, and extrapolated for SciPy at the paper's settings.

    The latter is the time for one simulated second, times the simulated seconds.
    """
    start = time.perf_counter()
    fits = fit_cases(cases, subject, 0, PAPER)
    paper_s = time.perf_counter() - start
    simulated_s = sum(
        fit.refined.evaluations * case.seat_mps2.size / case.rate_hz for fit, case in zip(fits, cases, strict=True)
    )
    seat = load_case("road", 2.0, np.random.default_rng(0), NATIVE_RATE_HZ).accel_mps2[:, 2]
    return paper_s, simulated_s * _seconds(lambda: rk45(Chain.of(subject), seat)) / 2.0


def _subjects_s(cases: list[Case], subject: Subject, workers: int) -> float:
    """Several subjects, one per task, as in a campaign; without the start of the workers."""
    with executor_of(f"processes:{workers}") as executor:
        list(executor.map(_one_subject, [cases[:1]] * 2, [subject] * 2))
        return _seconds(lambda: list(executor.map(_one_subject, [cases] * SUBJECTS, [subject] * SUBJECTS)))


def _one_subject(cases: list[Case], subject: Subject) -> Fit:
    return fit_joint(cases, subject, 0)


def _recording(subject: Subject, case: str) -> Recording:
    """A recording of six IMUs of a case, with all sensor errors."""
    rng = np.random.default_rng(list(CASES).index(case))
    recorder = Recorder(case, case)
    for stream in imu_streams(subject, load_case(case, SECONDS, rng), rng, quiet_s=3.0):
        recorder.push(stream.sensor, stream.stamps_ns, stream.accel_mps2)
    return recorder.finish()[0]


def _swarm_s(case: Case, subject: Subject) -> tuple[float, float]:
    """One swarm, ours and with NumPy's solver instead of the kernel."""
    surrogate = Surrogate([case], subject.mass_matrix)
    once = SwarmSettings(starts=1, polish=False)
    chain = Chain.of(subject)
    omega = 2.0 * np.pi * case.frequency_hz[None, :, None, None]
    dynamic = -(omega**2) * chain.M + 1j * omega * chain.C + chain.K
    load = np.broadcast_to(-chain.inertia_kg[:, None], (*dynamic.shape[:3], 1))
    many = np.repeat(dynamic, once.particles, axis=0), np.repeat(load, once.particles, axis=0)
    dense = _least(lambda: np.linalg.solve(*many), 3)
    return _least(lambda: search(surrogate, 0, once), 3), dense * (once.iterations + 1)


def _cost_ms(subject: Subject) -> tuple[float, float]:
    """The objective of 5 s, per item of a full batch, and singly."""
    seat = load_case("road", 5.0, np.random.default_rng(0), NATIVE_RATE_HZ).accel_mps2[:, 2]
    accel = Chain.of(subject).simulate(seat, NATIVE_RATE_HZ).accel_mps2[:, MEASURED_SEGMENT_INDEX]
    stamps = np.rint(np.arange(seat.size) / NATIVE_RATE_HZ * 1e9).astype(np.int64)
    case = Case.of(Recording("road", "road", NATIVE_RATE_HZ, stamps, seat, accel, ()))
    problem = TimeDomain([case], subject, RegularizationTerm(subject.parameters.vector()))
    theta = LOWER + (UPPER - LOWER) * np.random.default_rng(1).random((LANES, LOWER.size))
    batched = _least(lambda: problem.costs(theta), REPEATS) / LANES
    return 1e3 * batched, 1e3 * _least(lambda: problem.cost(theta[0]), REPEATS)


def _least(task: Callable[[], object], repeats: int) -> float:
    """The shortest of several runs, because other load only adds time."""
    return min(_seconds(task) for _ in range(repeats))


def _seconds(task: Callable[[], object]) -> float:
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


if __name__ == "__main__":
    print(render(rows()))
