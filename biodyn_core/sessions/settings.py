"""Settings of the events of a session. Like all modules of settings it imports no numpy."""

from __future__ import annotations

from dataclasses import dataclass

from biodyn_core.base.settings import check_settings, setting


@dataclass(frozen=True)
class SessionSettings:
    """Rules that find events in a session and name their loading conditions."""

    rest_least_s: float = setting(2.0, "shortest rest", "s", 1.0, 600.0)
    rest_level_mps2: float = setting(
        0.3, "largest rms of the seat about its mean, over all axes, that counts as rest", "m/s^2", 0.01, 5.0
    )
    rest_ratio: float = setting(
        3.0, "largest such rms over that of the quietest twentieth of the session: a smooth drive is no rest", "",
        1.0, 100.0,
    )  # fmt: skip
    rest_floor_mps2: float = setting(0.1, "a smaller rms counts as rest in every session", "m/s^2", 0.0, 5.0)
    rest_drift_mps2: float = setting(
        0.2, "largest distance of the mean reading of half a second from that of the rest: a vehicle that gathers speed"
        " is not at rest", "m/s^2", 0.01, 5.0,
    )  # fmt: skip
    shock_g: float = setting(0.8, "least peak of a shock, vertical, low-passed", "g", 0.1, 50.0)
    shock_crest: float = setting(5.0, "least peak of a shock over the level around it", "", 2.0, 100.0)
    around_s: float = setting(10.0, "length of the stretch around a shock that gives this level", "s", 2.0, 120.0)
    apart_s: float = setting(1.0, "shocks that follow each other within this time are one group", "s", 0.2, 10.0)
    strike_share: float = setting(
        0.5, "least peak of a single strike of a group, as a share of the largest", "", 0.05, 1.0
    )
    strike_apart_s: float = setting(0.1, "least time between two strikes of a group", "s", 0.02, 1.0)
    train_strikes: int = setting(3, "least number of strikes of a group that is a train of shocks", "", 2, 100)
    lead_s: float = setting(
        3.0, "length of an event before its first shock, the 2 s of warm-up included", "s", 2.2, 60.0
    )
    tail_s: float = setting(2.0, "length of an event after its last shock", "s", 0.5, 60.0)
    steady_least_s: float = setting(10.0, "shortest steady stretch", "s", 3.0, 600.0)
    steady_longest_s: float = setting(30.0, "longest steady stretch: a longer one is divided", "s", 5.0, 3600.0)
    steady_level_mps2: float = setting(
        0.2, "least rms of the seat, vertical, low-passed, in a steady stretch", "m/s^2", 0.01, 10.0
    )
    idle_share: float = setting(
        0.8, "a stretch with this share of its energy above idle_above_hz is an engine that idles, not a drive", "",
        0.1, 1.0,
    )  # fmt: skip
    idle_above_hz: float = setting(20.0, "lowest frequency of an engine that idles", "Hz", 5.0, 80.0)
    idle_level_mps2: float = setting(0.7, "largest rms of the seat that counts as idling", "m/s^2", 0.0, 10.0)
    train_case: str = setting("rail", "loading condition of a train of shocks")
    shock_case: str = setting("pothole", "loading condition of other shocks")
    steady_case: str = setting("road", "loading condition of a steady stretch")
    moved_deg: float = setting(5.0, "tilt of a sensor between two rests that is reported", "deg", 0.5, 90.0)
    drift_sigmas: float = setting(
        4.0, "least relative drift of a sensor's clock that is corrected, in standard errors", "", 1.0, 100.0
    )
    drift_ms: float = setting(0.5, "least such drift over the session that is corrected", "ms", 0.0, 1000.0)
    longest_h: float = setting(24.0, "longest session", "h", 0.1, 1000.0)

    def __post_init__(self) -> None:
        check_settings(self)
