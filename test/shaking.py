"""Persons, strong shaking and single moments for tests of the mechanisms of the background."""

from __future__ import annotations

import dataclasses

import numpy as np
from world import body, seats
from world.effects.effect import Moment, Person
from world.effects.event import HELD_HZ, Event
from world.effects.mechanism import Mechanism
from world.effects.mixture import MECHANISMS, UNSEEN_MECHANISMS

KNOWN = {**MECHANISMS, **UNSEEN_MECHANISMS}


def person(number: int = 0) -> Person:
    """One of some people, with typical travel of the joints."""
    one = Person.of(body.drawn(2, np.random.default_rng(number)), number % 2)
    rate = np.array([0.1, 0.08, 0.06, 0.05, 0.04, 0.03])
    return dataclasses.replace(one, reach_m=np.array([8.0, 6.0, 5.0, 4.0, 2.0, 2.0]) * 1e-3, rate_mps=rate)


def shaken(seconds: float = 0.5, after_s: float = 0.3) -> Event:
    """Strong shaking on every axis, up to 1.7 g, and rest after it."""
    t = np.arange(round((seconds + after_s) * HELD_HZ) * 2 + 1) / seats.RATE_HZ
    rise = np.sin(np.pi * np.minimum(t / seconds, 1.0)) ** 2
    up = 10.0 * np.sin(2 * np.pi * 9.0 * t) + 7.0 * np.sin(2 * np.pi * 4.0 * t)
    accel = np.column_stack([4.0 * np.sin(2 * np.pi * 5.0 * t), 3.0 * np.sin(2 * np.pi * 6.0 * t), up])
    return Event("rail", "synthetic", 0.0, rise[:, None] * accel, np.zeros((len(t), 2)), seconds, 1.0, seconds)


def made(kind: str, scale: float = 1.0, number: int = 0) -> Mechanism:
    """A mechanism of a kind for the person of that number."""
    return KNOWN[kind].of(person(number), scale, np.random.default_rng(number))


def moment(stretch: np.ndarray, rate: np.ndarray) -> Moment:
    """Bodies (r, 6) whose joints have these stretches and rates, and which carry no force yet."""
    now = Moment()
    now.stretch, now.rate = stretch, rate
    now.x, now.v = np.cumsum(stretch, axis=1), np.cumsum(rate, axis=1)
    now.joint_n, now.up_n, now.base_mps2 = np.zeros(stretch.shape), np.zeros(stretch.shape), np.zeros(len(stretch))
    now.share = np.full(len(stretch), 0.3)
    return now


def after(one: Mechanism, stretch: float, rate: float, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tensions of the joints (6,) and rates of the states (s,)."""
    now = moment(np.full((1, 6), stretch), np.full((1, 6), rate))
    rates = one.act(now, own[None])
    return now.joint_n[0], np.zeros(0) if rates is None else rates[0]
