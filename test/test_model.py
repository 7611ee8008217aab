"""The chain: printed tables, linear laws, and DOP853 on the paper's matrices for transients."""

from __future__ import annotations

import dataclasses
import itertools
from functools import cache

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper import THETAS, person, printed, shipped

from biodyn_core import kernels
from biodyn_core.base.errors import InputError
from biodyn_core.body.model import MAX_STEP_S, Chain, Stepper
from biodyn_core.body.parameters import LOWER, UPPER
from biodyn_core.body.subject import Subject

NATIVE_HZ = 1129.3
RATES_HZ = (250.0, 500.0, 1000.0, 1600.0)
NAMES = ("subject_1", "subject_2", "subject_1_as_printed", "subject_2_as_printed")
FORMS = st.sampled_from(["segment", "cascade"])

MILLIONS_OF_STEPS = pytest.mark.skipif(not kernels.COMPILED, reason="without numba this takes many minutes")


bodies = st.builds(person, THETAS, mass_matrix=FORMS, body_mass_kg=st.floats(30.0, 200.0))


def half_sine(peak_g: float, length_s: float, seconds: float, rate_hz: float, begin_s: float = 0.01) -> np.ndarray:
    """A seat at rest that gets one half-sine of acceleration, m/s^2."""
    return naive.half_sine(peak_g * naive.GRAVITY, length_s, seconds, rate_hz, begin_s)


def step(size_g: float, seconds: float, rate_hz: float) -> np.ndarray:
    """A seat at rest that suddenly accelerates for good, m/s^2."""
    return size_g * naive.GRAVITY * (np.arange(round(seconds * rate_hz)) > 0.01 * rate_hz).astype(float)


def relative_error(found: np.ndarray, wanted: np.ndarray) -> float:
    """Rms of the difference over rms of the truth."""
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


# --- what the paper prints -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", ["1", "2"])
def test_segment_masses_are_those_printed(number):
    mass = Chain.of(shipped(f"subject_{number}", mass_scale=1.0)).mass_kg
    wanted = [float(row["mass_kg"]) for row in printed("tables_4_5.csv", subject=number)]
    # gamma has three digits; 0.05937 is implied by the printed heads (3.479 and 4.393 kg), hence 0.7 % there.
    np.testing.assert_allclose(mass[:5], wanted[:5], rtol=1.2e-3)
    assert mass[5] == pytest.approx(wanted[5], rel=7e-3)
    total = float(printed("tables_4_5_totals.csv", subject=number)[0]["upper_body_kg"])
    assert mass.sum() == pytest.approx(total, rel=5e-4)


# Printed with heads heavier than gamma_6 (neck, head), and a pelvis that differs: see the tolerance in NAMED.
NAMED = {("1", "neck"): 7e-3, ("1", "head"): 7e-3, ("2", "pelvis"): 7e-3, ("2", "neck"): 7e-3, ("2", "head"): 7e-3}


@pytest.mark.parametrize("number", ["1", "2"])
def test_stiffness_is_that_of_tables_4_and_5(number):
    k = Chain.of(shipped(f"subject_{number}", mass_scale=1.0)).stiffness_n_per_m / 1000.0
    for found, row in zip(k, printed("tables_4_5.csv", subject=number), strict=True):
        # Elsewhere only gamma's three digits stand between: 0.15 %.
        tolerance = NAMED.get((number, row["joint"]), 1.5e-3)
        assert found == pytest.approx(float(row["k_kn_per_m"]), rel=tolerance), row["joint"]


@pytest.mark.parametrize("row", printed("modes.csv"), ids=lambda row: f"{row['subject']}-{row['mass_matrix']}")
def test_modal_frequencies_are_the_known_ones(row):
    suffix = "" if row["mass_matrix"] == "segment" else "_as_printed"
    modes = Chain.of(shipped(f"subject_{row['subject']}{suffix}")).modes()
    wanted = [float(row[f"f{mode}"]) for mode in range(1, 7)]
    np.testing.assert_allclose(modes.natural_frequency_hz, wanted, atol=0.006)  # printed to 0.01 Hz


# --- matrices and modes ----------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(bodies)
def test_the_matrices_are_the_hand_assembled_ones(subject):
    chain = Chain.of(subject)
    M, C, K, k, alpha = naive.chain_matrices(subject.parameters.vector(), subject.body_mass_kg, subject.mass_matrix)
    for found, wanted in ((chain.M, M), (chain.C, C), (chain.K, K)):
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())  # rounding
    np.testing.assert_allclose(chain.stiffness_n_per_m, k, rtol=1e-12)
    np.testing.assert_allclose(chain.stiffening_per_m, alpha, rtol=1e-12)


@settings(max_examples=30)
@given(bodies)
def test_m_c_and_k_are_symmetric_and_positive_definite(subject):
    chain = Chain.of(subject)
    for matrix in (chain.M, chain.C, chain.K):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0.0
    np.testing.assert_array_equal(chain.M, np.diag(np.diag(chain.M)))


@settings(max_examples=30)
@given(bodies)
def test_modes_are_mass_normalised_and_diagonalise_stiffness(subject):
    chain = Chain.of(subject)
    modes = chain.modes()
    omega = 2.0 * np.pi * modes.natural_frequency_hz
    assert (np.diff(omega) >= 0.0).all()
    np.testing.assert_allclose(modes.shapes.T @ chain.M @ modes.shapes, np.eye(6), atol=1e-10)  # rounding
    stiffness = modes.shapes.T @ chain.K @ modes.shapes
    np.testing.assert_allclose(stiffness, np.diag(omega**2), atol=1e-10 * omega[-1] ** 2)  # rounding
    shape = modes.shapes
    wanted = np.diag(shape.T @ chain.C @ shape) / (2.0 * omega * np.diag(shape.T @ chain.M @ shape))
    np.testing.assert_allclose(modes.damping_ratio, wanted, rtol=1e-9)  # Eq. 14, rounding


@settings(max_examples=30)
@given(bodies)
def test_pure_rayleigh_damping_is_alpha_over_two_omega(subject):
    chain = dataclasses.replace(Chain.of(subject), damping_n_s_per_m=np.zeros(6))
    modes = chain.modes()
    wanted = subject.parameters.rayleigh_rad_per_s / (2.0 * 2.0 * np.pi * modes.natural_frequency_hz)
    np.testing.assert_allclose(modes.damping_ratio, wanted, rtol=1e-9)  # Eq. 13, rounding


@settings(max_examples=30)
@given(bodies)
def test_the_largest_eigenvalue_is_that_of_the_quadratic_problem(subject):
    M, C, K, _, _ = naive.chain_matrices(subject.parameters.vector(), subject.body_mass_kg, subject.mass_matrix)
    inverse = np.linalg.inv(M)
    state = np.block([[-inverse @ C, -inverse @ K], [np.eye(6), np.zeros((6, 6))]])
    wanted = np.abs(np.linalg.eigvals(state)).max()
    # Two eigenvalues may coincide (critical damping); there they are good to the root of eps only.
    assert Chain.of(subject).largest_eigenvalue_rad_per_s == pytest.approx(wanted, rel=1e-6)


# --- linear response -------------------------------------------------------------------------------------------------

FREQUENCY = np.geomspace(0.05, 60.0, 60)


@pytest.mark.parametrize("name", NAMES)
def test_the_frequency_response_is_that_of_the_matrices(name):
    subject = shipped(name)
    theta = subject.parameters.vector()
    wanted = naive.transfer_functions(theta, subject.body_mass_kg, subject.mass_matrix, FREQUENCY)
    found = Chain.of(subject).frequency_response(FREQUENCY)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())  # rounding
    absolute = 1.0 - (2.0 * np.pi * FREQUENCY[:, None]) ** 2 * wanted
    np.testing.assert_allclose(Chain.of(subject).transmissibility(FREQUENCY), absolute, rtol=1e-7, atol=1e-9)


@settings(max_examples=30)
@given(bodies)
def test_at_standstill_the_body_moves_with_the_seat(subject):
    np.testing.assert_allclose(Chain.of(subject).transmissibility(1e-4), 1.0, atol=1e-6)  # of order f^2 and f alpha


@pytest.mark.parametrize("name", ["subject_1", "subject_2"])
def test_apparent_mass_at_a_tenth_of_a_hertz_is_the_upper_body(name):
    chain = Chain.of(shipped(name))
    for form in ("inertia", "joint"):
        found = chain.apparent_mass(0.1, form)[0]
        assert abs(found) == pytest.approx(chain.mass_kg.sum(), rel=5e-3)
        assert np.angle(found, deg=True) == pytest.approx(0.0, abs=0.2)  # damping's share at 0.1 Hz


@pytest.mark.parametrize("name", ["subject_1_as_printed", "subject_2_as_printed"])
def test_the_printed_mass_matrix_weighs_three_bodies(name):
    chain = Chain.of(shipped(name))
    ratio = abs(chain.apparent_mass(0.1, as_printed=True)[0]) / chain.mass_kg.sum()
    assert ratio == pytest.approx(sum((i + 1) * g for i, g in enumerate(naive.MASS_FRACTION)) / 0.581, rel=5e-3)
    assert 3.0 < ratio < 3.1


# Peak kg, its frequency, and the first peak of the impedance above 10 Hz: `joint` form, Tables 4 and 5 with m_scale.
# The inertia form, which has the Rayleigh part too, is higher: 62.9 kg and 86.5 kg.
PEAKS = [
    ("subject_1", "joint", 60.4, 3.75, 21.1),
    ("subject_2", "joint", 84.5, 4.4, 17.7),
    ("subject_1", "inertia", 62.9, 3.78, 21.3),
    ("subject_2", "inertia", 86.5, 4.42, 17.7),
]


@pytest.mark.parametrize(("name", "form", "peak_kg", "peak_hz", "impedance_hz"), PEAKS)
def test_apparent_mass_peaks_where_it_is_known_to(name, form, peak_kg, peak_hz, impedance_hz):
    frequency = np.arange(0.5, 40.0, 0.01)
    size = np.abs(Chain.of(shipped(name)).apparent_mass(frequency, form))
    assert size.max() == pytest.approx(peak_kg, abs=0.06)  # printed to 0.1 kg
    assert frequency[size.argmax()] == pytest.approx(peak_hz, abs=0.03)
    above = frequency > 10.0
    impedance = (2.0 * np.pi * frequency * size)[above]
    assert frequency[above][impedance.argmax()] == pytest.approx(impedance_hz, abs=0.06)


@pytest.mark.parametrize(("name", "peak", "peak_hz"), [("subject_1", 3.0, 4.05), ("subject_2", 3.65, 4.75)])
def test_seat_to_head_transmissibility_peaks_where_it_is_known_to(name, peak, peak_hz):
    frequency = np.arange(0.5, 40.0, 0.01)
    size = np.abs(Chain.of(shipped(name)).transmissibility(frequency)[:, 5])
    assert size.max() == pytest.approx(peak, abs=0.03)
    assert frequency[size.argmax()] == pytest.approx(peak_hz, abs=0.03)


@pytest.mark.parametrize(("form", "peak_kg"), [("joint", 168.7), ("paper", 257.5)])
def test_the_printed_mass_matrix_peaks_far_above_the_printed_curve(form, peak_kg):
    frequency = np.arange(0.5, 10.0, 0.01)
    size = np.abs(Chain.of(shipped("subject_1_as_printed")).apparent_mass(frequency, form, as_printed=True))
    assert size.max() == pytest.approx(peak_kg, abs=0.1)  # the paper prints 57.4 kg
    assert frequency[size.argmax()] == pytest.approx(2.7, abs=0.02)


# --- seat force ------------------------------------------------------------------------------------------------------


def steady_sine(subject: Subject, frequency_hz: float, rate_hz: float):
    """The answer to a sine once its start has died out: (chain, response, complex amplitude of anything (n, ...))."""
    cycles = 1.0 / frequency_hz
    settle, measure = 14.0, np.ceil(1.0 / cycles) * cycles
    time = np.arange(round((settle + measure) * rate_hz)) / rate_hz
    chain = Chain.of(subject)
    response = chain.simulate(np.sin(2.0 * np.pi * frequency_hz * time), rate_hz)
    late = slice(round(settle * rate_hz), None)
    basis = np.column_stack([np.sin(2.0 * np.pi * frequency_hz * time), np.cos(2.0 * np.pi * frequency_hz * time)])

    def amplitude(values):
        parts = np.linalg.lstsq(basis[late], values[late], rcond=None)[0]
        return parts[0] + 1j * parts[1]

    return chain, response, amplitude


@MILLIONS_OF_STEPS
@pytest.mark.parametrize("name", ["subject_1", "subject_2_as_printed"])
@pytest.mark.parametrize("frequency_hz", [0.5, 4.0, 12.0, 31.0])
def test_the_response_to_a_sine_is_the_frequency_response(name, frequency_hz):
    subject = shipped(name, stiffening_scale=0.0)
    # A sine drawn in straight lines is sinc^2 as high, and the body does not follow what the corners add near 4000 Hz.
    chain, response, amplitude = steady_sine(subject, frequency_hz, 4000.0)
    between = np.sinc(frequency_hz / 4000.0) ** 2
    wanted = chain.transmissibility(frequency_hz)[0]
    found = amplitude(response.accel_mps2)
    np.testing.assert_allclose(found, wanted * between, atol=1e-6 * np.abs(wanted).max())  # what it does follow
    motion = amplitude(response.displacement_m) / between
    np.testing.assert_allclose(motion, chain.frequency_response(frequency_hz)[0], rtol=1e-6)
    speed = amplitude(response.velocity_mps) / (2j * np.pi * frequency_hz)
    np.testing.assert_allclose(speed, amplitude(response.displacement_m), rtol=1e-6)


@MILLIONS_OF_STEPS
@pytest.mark.parametrize("form", ["inertia", "joint", "paper"])
@pytest.mark.parametrize("frequency_hz", [0.5, 4.0])
def test_seat_force_over_time_is_the_apparent_mass_over_frequency(form, frequency_hz):
    chain, response, amplitude = steady_sine(shipped("subject_1", stiffening_scale=0.0), frequency_hz, 2000.0)
    found = amplitude(chain.seat_force(response, form))
    assert found == pytest.approx(chain.apparent_mass(frequency_hz, form)[0], rel=1e-4)  # the seat's straight lines


def test_inertia_is_joint_force_plus_rayleigh_part_under_a_shock():
    subject = shipped("subject_2")
    chain = Chain.of(subject)
    response = chain.simulate(half_sine(-5.0, 0.03, 0.5, 4000.0), 4000.0)
    rayleigh = -subject.parameters.rayleigh_rad_per_s * response.velocity_mps @ chain.mass_kg
    wanted = chain.seat_force(response, "joint") + rayleigh  # Newton on the whole body
    found = chain.seat_force(response)
    np.testing.assert_allclose(found, wanted, atol=1e-9 * np.abs(found).max())  # an identity of every state: rounding


@pytest.mark.parametrize("name", ["subject_1", "subject_2"])
def test_the_printed_seat_force_points_the_wrong_way(name):
    chain = Chain.of(shipped(name))
    printed = chain.apparent_mass(0.5, "paper")[0]
    assert abs(np.angle(printed, deg=True)) == pytest.approx(180.0, abs=0.5)
    k = chain.stiffness_n_per_m
    # and carries joint 2, which the seat does not.
    assert abs(printed) == pytest.approx(abs(chain.apparent_mass(0.5, "joint")[0]) * (k[0] + k[1]) / k[0], rel=1e-2)


@pytest.mark.parametrize("form", ["inertia", "joint", "paper"])
def test_forces_under_the_printed_mass_matrix_are_refused_unless_asked_for(form):
    chain = Chain.of(shipped("subject_1_as_printed"))
    response = chain.simulate(step(1.0, 0.1, NATIVE_HZ), NATIVE_HZ)
    for ask in (lambda **kw: chain.apparent_mass(1.0, form, **kw), lambda **kw: chain.seat_force(response, form, **kw)):
        with pytest.raises(InputError, match="as_printed"):
            ask()
        assert np.isfinite(ask(as_printed=True)).all()


def test_an_unknown_form_of_the_seat_force_is_refused():
    chain = Chain.of(shipped("subject_1"))
    with pytest.raises(InputError, match=r"'spring', allowed are inertia, joint and paper"):
        chain.apparent_mass(1.0, "spring")


# --- transients ------------------------------------------------------------------------------------------------------

TRANSIENTS = {
    "step": step(1.0, 0.5, NATIVE_HZ),
    "pothole": half_sine(-3.0, 0.05, 0.5, NATIVE_HZ),
    "shock": half_sine(-5.0, 0.02, 0.5, NATIVE_HZ),
}
ONE_IN_A_MILLION = 1e-6
"""The mark for a simulation at the native rate, rms of the error over rms of the acceleration."""

# One step a sample is what 1129.3 Hz gets; with segment masses |eigenvalue| x step is then 0.54 and 0.44.
TOO_COARSE = {
    ("subject_1", "step"), ("subject_1", "pothole"), ("subject_1", "shock"),
    ("subject_2", "pothole"), ("subject_2", "shock"), ("subject_2_as_printed", "shock"),
}  # fmt: skip


def transient_error(name: str, case: str, finer: int = 1) -> float:
    """The error of `simulate` against DOP853, its steps `finer` times shorter and the seat linear between samples."""
    subject, seat = shipped(name), TRANSIENTS[case]
    assert subject.parameters.stiffening_scale > 0.2  # nonlinear
    between = np.arange((seat.size - 1) * finer + 1) / finer
    drawn = np.interp(between, np.arange(seat.size), seat)
    found = Chain.of(subject).simulate(drawn, NATIVE_HZ * finer).accel_mps2[::finer]
    return relative_error(found, truths(case)[NAMES.index(name)])


@cache
def truths(case: str) -> np.ndarray:
    """The responses (names, n, 6) of all subjects by DOP853."""
    bodies = [(one.parameters.vector(), one.body_mass_kg, one.mass_matrix) for one in map(shipped, NAMES)]
    return naive.chain_responses(bodies, TRANSIENTS[case], NATIVE_HZ)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", TRANSIENTS)
def test_a_transient_response_is_that_of_dop853(name, case):
    # The mark of 1e-6 needs two substeps where one step a sample is too coarse; with one it is 1.6e-5 at most.
    finer = 2 if (name, case) in TOO_COARSE else 1
    limit = 1.2 * ONE_IN_A_MILLION if finer == 2 else ONE_IN_A_MILLION
    assert transient_error(name, case, finer) <= limit


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", TRANSIENTS)
def test_a_transient_is_never_worse_than_the_solver_of_the_paper(name, case):
    # RK45 at rtol 1e-6, atol 1e-9, max step 1 ms errs by 4e-5; found here: 1.6e-5 at most.
    assert transient_error(name, case) <= 2e-5


@pytest.mark.parametrize("name", NAMES)
def test_half_the_step_leaves_a_sixteenth_of_the_error(name):
    coarse, fine = (transient_error(name, "shock", finer) for finer in (2, 4))
    assert 10.0 < coarse / fine < 25.0  # fourth order; the kinks of strain stiffening keep it from being exact


# Table 1's corners: all low, all high, and thirty drawn once.
_DRAW = np.random.default_rng(20)
CORNERS = [np.where(high, UPPER, LOWER) for high in [np.zeros(15), np.ones(15), *(_DRAW.random((30, 15)) < 0.5)]]


@pytest.mark.parametrize("form", ["segment", "cascade"])
@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_at_the_corners_of_table_1_the_response_to_a_shock_is_finite_at_any_rate(form, rate_hz):
    seat = half_sine(-5.0, 0.04, 0.15, rate_hz)
    truths = naive.chain_responses([(theta, 70.0, form) for theta in CORNERS], seat, rate_hz)
    errors = [
        relative_error(Chain.of(person(theta, mass_matrix=form)).simulate(seat, rate_hz).accel_mps2, truth)
        for theta, truth in zip(CORNERS, truths, strict=True)
    ]
    assert max(errors) <= 1e-4  # found: 4.6e-5 at 1000 Hz with segment masses; the paper's solver has 4e-5


@MILLIONS_OF_STEPS
@pytest.mark.parametrize("form", ["segment", "cascade"])
@pytest.mark.parametrize("rate_hz", [250.0, 400.0, NATIVE_HZ])
def test_at_the_corners_of_table_1_the_worst_shock_dies_out(form, rate_hz):
    seat = half_sine(-15.0, 0.06, 4.0, rate_hz)
    for high in _CORNER_SAMPLE:
        accel = Chain.of(person(np.where(high, UPPER, LOWER), mass_matrix=form)).simulate(seat, rate_hz).accel_mps2
        peak = np.abs(accel).max()
        assert peak < 250.0 * naive.GRAVITY  # found: 143 g
        # The slowest decay Table 1 allows is alpha_r / 2 + zeta w >= 0.05 + 0.2 per second and more.
        assert np.abs(accel[-round(0.1 * rate_hz) :]).max() < 0.5 * peak


_CORNER_SAMPLE = [corner for at, corner in enumerate(itertools.product((0, 1), repeat=15)) if at % 193 == 0]


# --- laws of the motion ----------------------------------------------------------------------------------------------


def energy(subject: Subject, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Kinetic energy and the integral of every joint's force, relative to the seat, J."""
    M, _, _, k, alpha = naive.chain_matrices(subject.parameters.vector(), subject.body_mass_kg, subject.mass_matrix)
    stretch = x - np.column_stack([np.zeros(len(x)), x[:, :-1]])
    stored = k * stretch**2 / 2.0 + k * alpha * np.abs(stretch) ** 3 / 3.0
    return (v**2 @ np.diag(M)) / 2.0 + stored.sum(axis=1)


@settings(max_examples=30)
@given(bodies, st.integers(0, 2**32 - 1), st.sampled_from([*RATES_HZ, NATIVE_HZ]), st.floats(0.1, 150.0))
def test_energy_is_never_created_while_the_seat_rests(subject, seed, rate_hz, size):
    pulse = size * np.random.default_rng(seed).standard_normal(30)  # leaves the body in a random state
    chain = Chain.of(subject)
    response = chain.simulate(np.append(pulse, np.zeros(250)), rate_hz)
    total = energy(subject, response.displacement_m, response.velocity_mps)
    left = total[len(pulse) :]
    assert left[0] > 0.0
    assert (np.diff(left) <= 1e-12 * left[0]).all()  # rounding


@settings(max_examples=30)
@given(bodies, st.integers(0, 2**32 - 1))
def test_the_mass_scale_cancels_from_accelerations(subject, seed):
    seat = 20.0 * np.random.default_rng(seed).standard_normal(200)
    answers = []
    for scale in (0.85, 1.15):
        parameters = dataclasses.replace(subject.parameters, mass_scale=scale)
        chain = Chain.of(dataclasses.replace(subject, parameters=parameters))
        answers.append(chain.simulate(seat, NATIVE_HZ).accel_mps2)
    np.testing.assert_allclose(*answers, atol=1e-12 * np.abs(answers[0]).max(), rtol=0.0)  # rounding


@settings(max_examples=30)
@given(bodies, st.integers(0, 2**32 - 1), st.floats(0.01, 100.0))
def test_the_linear_chain_is_linear(subject, seed, factor):
    parameters = dataclasses.replace(subject.parameters, stiffening_scale=0.0)
    chain = Chain.of(dataclasses.replace(subject, parameters=parameters))
    a, b = np.random.default_rng(seed).standard_normal((2, 150))
    apart = chain.simulate(a, NATIVE_HZ).accel_mps2 + factor * chain.simulate(b, NATIVE_HZ).accel_mps2
    together = chain.simulate(a + factor * b, NATIVE_HZ).accel_mps2
    np.testing.assert_allclose(together, apart, atol=1e-10 * np.abs(apart).max(), rtol=0.0)  # rounding


@settings(max_examples=30)
@given(bodies, st.integers(0, 2**32 - 1))
def test_up_and_down_are_alike(subject, seed):
    seat = 30.0 * np.random.default_rng(seed).standard_normal(150)
    chain = Chain.of(subject)
    np.testing.assert_array_equal(chain.simulate(-seat, 500.0).accel_mps2, -chain.simulate(seat, 500.0).accel_mps2)


@MILLIONS_OF_STEPS
@settings(max_examples=30)
@given(bodies)
def test_a_body_on_a_steady_seat_ends_up_moving_with_it(subject):
    seat = np.full(round(120.0 * 250.0), 2.0)  # the slowest corner needs 100 s
    response = Chain.of(subject).simulate(seat, 250.0)
    np.testing.assert_allclose(response.accel_mps2[-1], 2.0, atol=1e-3)


# --- the stepper -----------------------------------------------------------------------------------------------------

CUTS = st.lists(st.integers(0, 300), max_size=12).map(sorted)


@settings(max_examples=30)
@given(bodies, CUTS, st.sampled_from([*RATES_HZ, NATIVE_HZ]))
def test_any_cut_into_blocks_gives_the_same_bits(subject, cuts, rate_hz):
    seat = 20.0 * np.sin(np.arange(300.0) ** 1.3)
    chain = Chain.of(subject)
    stepper = Stepper(chain, rate_hz)
    parts = [stepper.push(part) for part in np.split(seat, cuts)]
    np.testing.assert_array_equal(np.concatenate(parts), chain.simulate(seat, rate_hz).accel_mps2)


@pytest.mark.parametrize("rate_hz", [250.0, NATIVE_HZ])
def test_sample_by_sample_gives_the_same_bits_and_the_same_motion(rate_hz):
    seat = half_sine(-5.0, 0.02, 0.4, rate_hz)
    chain = Chain.of(shipped("subject_1"))
    whole = chain.simulate(seat, rate_hz)
    stepper, motion = Stepper(chain, rate_hz), np.empty((seat.size, 18))
    accel = np.concatenate([stepper.push(seat[n : n + 1], motion[n : n + 1]) for n in range(seat.size)])
    np.testing.assert_array_equal(accel, whole.accel_mps2)
    np.testing.assert_array_equal(motion[:, :6], whole.displacement_m)
    np.testing.assert_array_equal(motion[:, 6:12], whole.velocity_mps)
    np.testing.assert_array_equal(motion[:, 12:], whole.joint_force_n)


def test_after_reset_the_chain_is_at_rest_again():
    chain = Chain.of(shipped("subject_2"))
    seat = 5.0 + half_sine(-5.0, 0.02, 0.2, NATIVE_HZ)
    stepper = Stepper(chain, NATIVE_HZ)
    first = stepper.push(seat)
    stepper.reset()
    np.testing.assert_array_equal(stepper.push(seat), first)
    # At rest no joint is stretched, so nothing is accelerated yet, whatever the seat does.
    np.testing.assert_array_equal(first[0], np.zeros(6))


def test_velocity_and_acceleration_belong_to_the_displacement():
    rate_hz = 4000.0
    response = Chain.of(shipped("subject_1")).simulate(half_sine(-3.0, 0.05, 0.3, rate_hz), rate_hz)
    x, v = response.displacement_m, response.velocity_mps
    # Central differences: their own error is (w h)^2 / 6 with w about 250 rad/s.
    np.testing.assert_allclose((x[2:] - x[:-2]) * rate_hz / 2.0, v[1:-1], atol=1e-3 * np.abs(v).max())
    relative = response.accel_mps2 - response.seat_mps2[:, None]
    np.testing.assert_allclose((v[2:] - v[:-2]) * rate_hz / 2.0, relative[1:-1], atol=1e-2 * np.abs(relative).max())


@settings(max_examples=30)
@given(bodies, st.floats(100.0, 20_000.0))
def test_steps_are_a_whole_part_of_a_sample_and_at_most_a_millisecond(subject, rate_hz):
    stepper = Stepper(Chain.of(subject), rate_hz)
    assert stepper.substeps >= 1
    assert 1.0 / (rate_hz * stepper.substeps) <= MAX_STEP_S * (1.0 + 1e-6)  # rounding


def test_an_empty_input_gives_an_empty_output():
    chain = Chain.of(shipped("subject_1"))
    assert chain.simulate([], NATIVE_HZ).accel_mps2.shape == (0, 6)
    stepper = Stepper(chain, NATIVE_HZ)
    assert stepper.push(np.empty(0)).shape == (0, 6)
    np.testing.assert_array_equal(stepper.push(np.ones(3)), chain.simulate(np.ones(3), NATIVE_HZ).accel_mps2)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate_hz):
    with pytest.raises(InputError, match="rate_hz is "):
        Stepper(Chain.of(shipped("subject_1")), rate_hz)
