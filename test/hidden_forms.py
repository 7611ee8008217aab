"""Forms of the hidden effects in tests: a shaken body, and the force of a form for a given motion."""

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import integrate
from world import body, seats
from world.effects import development_forms, earlier_forms, second_forms, third_forms
from world.effects.effect import Effect, Moment, Person
from world.effects.event import Event

FIRST = (*development_forms.FORMS, *earlier_forms.FORMS)
EVERY = (*FIRST, *second_forms.FORMS, *third_forms.FORMS)
PERSON = dataclasses.replace(
    Person.of(body.drawn(2, np.random.default_rng(3)), 0),
    reach_m=np.array([8.0, 6.0, 5.0, 4.0, 2.0, 2.0]) * 1e-3,
    rise_m=np.full(6, 8e-3),
    rate_mps=np.array([0.1, 0.08, 0.06, 0.05, 0.04, 0.03]),
)
SHORT_S = 0.25


def of_kind(*kinds: str, among: tuple[type[Effect], ...] = FIRST) -> list[type[Effect]]:
    return [form for form in among if form.kind in kinds]


def made(form: type[Effect], seed: int = 0) -> Effect:
    one = form.drawn(np.random.default_rng(seed))
    return dataclasses.replace(one, at_s=0.4 * SHORT_S) if hasattr(one, "at_s") else one


def shaken() -> Event:
    """Half a second of strong shaking on every axis, without rest before it, which is all of the sitting."""
    t = np.arange(2 * round(0.5 * SHORT_S * seats.RATE_HZ) + 1) / seats.RATE_HZ
    rise = np.sin(np.pi * np.minimum(t / SHORT_S, 1.0)) ** 2
    up = 25.0 * np.sin(2 * np.pi * 9.0 * t) + 15.0 * np.sin(2 * np.pi * 4.0 * t)
    forward, left = 4.0 * np.sin(2 * np.pi * 5.0 * t), 3.0 * np.sin(2 * np.pi * 6.0 * t)
    angle = 0.03 * np.column_stack([np.sin(2 * np.pi * 4.0 * t), np.sin(2 * np.pi * 3.0 * t)])
    accel = np.column_stack([forward, left, up])
    return Event("rail", "synthetic", 0.0, rise[:, None] * accel, rise[:, None] * angle, SHORT_S, 1.0, SHORT_S)


def moment(stretch: float = 0.0, rate: float = 0.0, count: int = 1) -> Moment:
    """A body whose joints are all stretched so far and so fast."""
    now = Moment()
    now.person, now.up_n = PERSON, np.zeros((count, 6))
    now.stretch, now.rate = np.full((count, 6), stretch), np.full((count, 6), rate)
    now.x, now.v = np.cumsum(now.stretch, axis=1), np.cumsum(now.rate, axis=1)
    now.joint_n = PERSON.stiffness_n_per_m * now.stretch + PERSON.damping_ns_per_m * now.rate
    now.base_mps2, now.signal, now.late = np.zeros(count), np.ones((count, 1)), np.zeros((count, 2))
    now.time_s, now.share, now.moving_s = np.full(count, 1.0), np.full(count, 0.5), 1.0
    return now


def tension(effect: Effect, stretch: float, rate: float = 0.0, own: np.ndarray | None = None) -> float:
    """Force of an effect in its joint, N."""
    now = moment(stretch, rate)
    effect.act(now, np.zeros((1, effect.states)) if own is None else own)
    return float(-now.up_n[0, effect.site])


def followed(effect: Effect, stretch: Callable[[float], float], rate: Callable[[float], float], t: np.ndarray):
    """The joint's pull (n,) along a given path, its states integrated by LSODA."""

    def slope(at: float, own: np.ndarray) -> np.ndarray:
        return effect.act(moment(stretch(at), rate(at)), own[None])[0]

    own = integrate.solve_ivp(slope, (0.0, t[-1]), np.zeros(effect.states), "LSODA", t, rtol=1e-8, atol=1e-12).y.T
    return np.array([tension(effect, stretch(at), rate(at), one[None]) for at, one in zip(t, own, strict=True)])


def k_b(effect: Effect) -> tuple[float, float]:
    return PERSON.stiffness_n_per_m[effect.site], PERSON.damping_ns_per_m[effect.site]


@dataclasses.dataclass(frozen=True, eq=False)
class Fixed(Effect):
    """A sensor with a given tilt."""

    lean: np.ndarray

    def lean_rad(self, sensor: int, event: Event) -> np.ndarray:
        """Always."""
        return self.lean
