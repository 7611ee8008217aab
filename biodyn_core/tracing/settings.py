"""Settings of a trace: every number that decides about data or that is tuned, in a group for each part of the method.

The model of the probabilities was learned with the defaults. Options of the command carry the names of the fields with
a `setting`; the others are not everyday options.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from biodyn_core.base.settings import check_settings, setting
from biodyn_core.identification.settings import FitSettings, SwarmSettings

BASE = FitSettings(
    phase1="pooled", clocks="trusted", refined_starts=2, swarm=SwarmSettings(particles=40, iterations=120, starts=3)
)
"""The refit of theta before the search: clocks are trusted, because a clock error is one of the candidates."""


@dataclass(frozen=True)
class FloorSettings:
    """The least data for a verdict, once for fitting and once held out.

    The tracing study uses 30 s of road, three potholes and three rails. Shocks are counted by the peak of the seat.
    """

    road_s: float = setting(30.0, "seconds without shocks", "s", 1.0, 3600.0)
    shocks: int = setting(6, "shocks, hard ones included", "", 0, 1000)
    hard_shocks: int = setting(1, "hard shocks", "", 0, 1000)
    shock_g: float = setting(0.8, "least peak of a shock", "g", 0.1, 10.0)
    hard_shock_g: float = setting(2.0, "least peak of a hard shock", "g", 0.2, 20.0)
    apart_s: float = 1.0
    """Peaks closer than this belong to one shock, such as those of two axles."""
    masked_share: float = 0.02
    """A sensor is left out of an event if this share more of it is masked than of the best sensor."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class WeightSettings:
    """Weights of samples and windows: one over the expected error of a good model, and the independent share."""

    noise_mps2: float = setting(0.025, "noise of a channel after the low-pass, rms", "m/s^2", 1e-4, 10.0)
    local_share: float = setting(0.04, "expected error as a share of the motion around a sample", "", 0.0, 1.0)
    event_share: float = setting(0.015, "expected error as a share of the motion of the event", "", 0.0, 1.0)
    counted_s: float = setting(1.0, "length of a window", "s", 0.1, 10.0)
    independent: float = setting(0.001, "share of the samples that count as independent", "", 1e-6, 1.0)
    decimated_hz: float = 280.0
    """Rate of the samples that are compared: all channels are low-passed at 100 Hz, so closer ones add nothing."""
    around_s: float = 0.5
    """Length over which the motion around a sample is averaged for its weight."""
    least_samples: int = 50
    """A window with fewer compared samples does not count in a gain."""
    reweightings: int = 2
    """The variances of the events and the nuisance parameters are computed in turn so many times."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class TypicalSettings:
    """Typical deviations of bodies and sensors from the model, as standard deviations.

    Sensors: data sheets, a mounting by belt, and clocks set once before an event. Bodies: the tracing study.
    """

    usual_gain: float = setting(0.015, "gain error of a sensor", "", 1e-4, 0.5)
    usual_clock_s: float = setting(0.0005, "offset of a sensor's clock", "s", 1e-6, 0.1)
    usual_lean: float = setting(0.025, "tilt of a sensor in motion, as a share of g", "", 1e-4, 0.5)
    rest_lean: float = setting(0.008, "tilt at rest from the bias of a sensor, as a share of g", "", 1e-4, 0.1)
    usual_softness_s: float = setting(0.0005, "softness of a sensor's mounting, 1 / (2 pi f)", "s", 1e-6, 0.02)
    usual_level_mps2: float = setting(0.2, "offset of a sensor from its mean at rest", "m/s^2", 1e-3, 10.0)
    usual_bend: float = setting(
        0.1, "nonlinear force of a joint at its reach, as a share of its linear force", "", 1e-3, 1.0
    )
    usual_mass: float = setting(0.06, "mass of a segment relative to its table", "", 1e-3, 0.5)
    drift_s: float = 5.0
    """A clock that drifts has the typical offset after this time, the middle of an event."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class NuisanceSettings:
    """Weights of samples, typical deviations, and the prior of theta."""

    theta_spread: float = setting(0.5, "prior spread of theta around the fit, in its logarithm", "", 0.01, 10.0)
    weights: WeightSettings = field(default_factory=WeightSettings)
    typical: TypicalSettings = field(default_factory=TypicalSettings)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class LocalFitSettings:
    """Local fits: Gauss-Newton steps of theta, the nuisance parameters and one effect."""

    steps: int = 12
    """Largest number of steps."""
    least_decrease: float = 0.002
    """A step that reduces the objective by less than this share ends the fit."""
    step_shares: tuple[float, ...] = (1.0, 0.5, 0.2, 0.05)
    """Shares of a step, tried in this order until one reduces the objective."""
    psi_spread: float = 6.0
    """Prior spread of one step of an effect's parameter, which is mapped to the real line."""
    inside: float = 0.02
    """A start keeps this share of each range from both ends, except for nuisances of the effect such as an instant."""
    weaker_starts: tuple[float, ...] = (0.5, 0.25, 0.12, 0.06)
    """Shares of a start's strength that are tried while the start fits worse than no effect, or is unstable."""
    weaker_ends: tuple[float, ...] = (0.85, 0.7, 0.5, 0.3)
    """Shares of a fitted strength that are tried while the fit is unstable in an event for choosing."""
    least_share: float = 1e-4
    """A weaker strength keeps this share of its range from both ends."""
    prior_scales: tuple[float, ...] = (1.0, 0.56, 0.32, 0.18, 0.1)
    """Prior scales of the nuisance parameters, 1 among them; the fit chooses the one with the largest evidence."""


@dataclass(frozen=True)
class PreliminarySettings:
    """Selection of candidates before the fits to all events."""

    steps: int = 5
    """Largest number of steps of a fit to few events."""
    generalised: int = 12
    """So many candidates, by the reduction of the objective to first order, have a fit of the general form as well."""
    general_steps: int = 3
    """Largest number of steps of such a fit."""
    least_decrease: float = 0.01
    """A step that reduces the objective by less than this share ends the first fit of a candidate."""
    least_fit: float = 0.01
    """Least reduction of the objective, as a share of the largest one, to first order."""
    least_fit_of_all: float = 0.05
    """Least reduction of the objective; the least one of effects hidden in 13 bodies is 0.1."""
    strengths: tuple[float, float] = (1.0, 3.0)
    """Least and largest start of a strength, in shares of its start value."""
    many_starts: int = 4
    """The first candidates of the shortlist start from all their shapes and strengths."""


@dataclass(frozen=True)
class EvidenceSettings:
    """Facts of the evidence."""

    good_fit: float = 0.9
    """Below this multiple of a good model's residual, the prior scale of a body can be estimated."""
    least_improvement: float = 0.01
    """An effect that lowers the error of the events for choosing by a smaller share is not added to the subject."""
    near_bound: float = 0.1
    """Theta this close to a bound without an effect, as a share of its range, is not moved there by the effect."""


@dataclass(frozen=True)
class UnsteadySettings:
    """Causes that vary from window to window."""

    parts: int = 4
    """Parts of a window; amplitude and phase of a line are fitted in each."""
    segment_s: float = 1.0
    """Length of the segments of the spectrum of a line; 1 s resolves 1 Hz."""
    most_late_s: float = 0.02
    """A larger clock offset has another cause."""
    line_hz: tuple[float, float] = (10.0, 80.0)
    """Range of frequencies of a spectral line."""
    around_hz: float = 10.0
    """Half-width of the spectrum that a line is compared with."""
    prominence: float = 3.0
    """A line exceeds the spectrum around it by this factor."""
    least_line_mps2: float = 0.01
    """A smaller amplitude of a line counts as this one."""
    most_growth: float = 3.0
    """Largest ratio of a line's size in the quarter of parts with most motion to that with least.

    In simulated bodies with a periodic force the ratio is 0.8 to 1.9. It is 4.8 or more if a muscle trembles with its
    load, or a joint lacks a law of the seat's motion.
    """


@dataclass(frozen=True)
class TiltSettings:
    """Sensor tilt by the gyro."""

    most_typical: float = 3.0
    """Largest typical tilt, in multiples of `usual_lean`."""


@dataclass(frozen=True)
class DiagnosticSettings:
    """Diagnostics of the residual."""

    failing: float = 2.0
    """A sub-chain fails if its error exceeds that of the best one by this factor."""
    band_hz: tuple[float, float] = (0.5, 60.0)
    """Frequencies of the coherence and of the sub-chains."""
    coherence_s: float = 2.0
    """Length of the windows of the coherence."""
    most_joint_ratio: float = 100.0
    """Stiffness and damping of a sub-chain's joints differ from the subject's own by at most this factor."""
    joint_evaluations: int = 12
    """Largest number of evaluations of a sub-chain's fit."""
    least_slope_events: int = 3
    """Fewer events have no slope of the residual over the level."""
    least_slope_range: float = 0.3
    """Nor do peaks of the seat within this range of their logarithm."""
    least_jump_windows: int = 8
    """Fewer windows have no jump of the residual."""
    shuffles: int = 200
    """Random orders of the windows for the p-value of a jump."""


@dataclass(frozen=True)
class JointRefitSettings:
    """Refit of theta and all effects together, without nuisance parameters."""

    inside: float = 0.02
    """A start keeps this share of each range from both ends, as that of theta does."""
    first_evaluations: int = 75
    """Largest number of evaluations of all cases from each start."""
    evaluations: int = 1500
    """The same from the best end."""
    least_decrease: float = 1e-5
    """A step that decreases the sum of squares by a smaller share is the last one: at 1e-4, 0.7 % was left once."""
    halvings: int = 8
    """The strengths of a start that is unstable are halved at most so many times."""
    prior_weight: float = 1e-5
    """Weight of the prior of general parameters beside the relative squares of residuals.

    It decides only what the events do not.
    """
    theta_spread: float = 0.5
    """Prior spread of ln theta in the covariance: it bounds what is unknown."""
    psi_spread: float = 3.0
    """The same of the effects' parameters on the real line."""


@dataclass(frozen=True)
class SurfaceSettings:
    """Free surface of the force of one joint over stretch and rate."""

    candidates: int = 3
    """The joints among so many of the most probable candidates are tried."""
    height_spread: float = 0.1
    """Prior spread of a hat's height, as a share of the joint's linear force at its reach."""
    reach_percent: float = 99.0
    """The reach is this percentile of stretch and rate."""


@dataclass(frozen=True)
class MissingForceSettings:
    """Missing force of a joint or segment by inverse dynamics, and its law."""

    least_high_pass_hz: float = 0.5
    """Least cut-off of the double integration: below it the bias of sensors exceeds the motion of joints."""
    high_pass_share: float = 0.1
    """Cut-off as a share of the joint's natural frequency: a stiff joint follows slow motion by less than the noise."""
    padded_s: float = 4.0
    """Zeros after a signal, so that its end does not reach its beginning: two periods of the least cut-off."""
    settled_s: float = 1.0
    """Samples within this time after the warm-up are not used: the integration starts there."""
    longest_s: float = 60.0
    """Events are used in order until they are longer together."""
    stretch_bins: int = 25
    """Bins of the stretch, of equal width from the smallest to the largest value."""
    rate_bins: int = 13
    """The same of its rate."""
    least_samples: int = 3
    """A bin with fewer samples has no mean."""
    draws: int = 40
    """Subjects drawn for the band of a law."""


@dataclass(frozen=True)
class ReportSettings:
    """Facts beside the verdict."""

    likely_fault: float = 0.05
    """A sensor fault with at least this probability is reported."""
    noise_band_hz: tuple[float, float] = (60.0, 85.0)
    """In this band bodies hardly move, so the error of a model is sensor noise."""
    noise_samples: int = 1024
    """Segments of the spectrum of the noise; a shorter event does not count."""


@dataclass(frozen=True)
class TraceSettings:
    """Settings of a trace."""

    most_effects: int = setting(3, "largest number of effects that are added", "", 1, 10)
    named_from: float = setting(0.8, "probability from which one cause is named", "", 0.5, 1.0)
    replicates: int = setting(200, "random draws of the largest gain", "", 20, 100_000)
    refined: int = setting(12, "candidates that are fitted to all events", "", 1, 1000)
    generalised: int = setting(5, "best ones of these, and best mechanisms, with fits of general laws", "", 0, 1000)
    enough: float = setting(0.5, "multiple of a good model's residual below which the search ends", "", 0.0, 100.0)
    floor: FloorSettings = field(default_factory=FloorSettings)
    nuisance: NuisanceSettings = field(default_factory=NuisanceSettings)
    base: FitSettings = BASE
    local_fit: LocalFitSettings = field(default_factory=LocalFitSettings)
    preliminary: PreliminarySettings = field(default_factory=PreliminarySettings)
    evidence: EvidenceSettings = field(default_factory=EvidenceSettings)
    unsteady: UnsteadySettings = field(default_factory=UnsteadySettings)
    tilt: TiltSettings = field(default_factory=TiltSettings)
    diagnostics: DiagnosticSettings = field(default_factory=DiagnosticSettings)
    joint_refit: JointRefitSettings = field(default_factory=JointRefitSettings)
    surface: SurfaceSettings = field(default_factory=SurfaceSettings)
    missing_force: MissingForceSettings = field(default_factory=MissingForceSettings)
    report: ReportSettings = field(default_factory=ReportSettings)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def few_steps(self) -> LocalFitSettings:
        """Settings of a local fit to few events."""
        return replace(self.local_fit, steps=self.preliminary.steps)
