"""Moves many bodies through many events at once: Runge and Kutta's fourth order on the seats' own grid of samples.

A step is two samples of the seat, so that every stage finds its seat on a sample and nothing is interpolated. Laws
with kinks (contact, friction) lose the fourth order at the kink; the tests state the remaining order. Delays look into
the states of past steps by cubic Hermite curves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from world.effects.background import NOTHING, Background
from world.effects.effect import Effect, Moment, Person
from world.effects.event import HELD_HZ, REST_S, Event
from world.effects.mechanism import Mechanism

Floats = NDArray[np.float64]

STEP_S: Final = 1.0 / HELD_HZ
RUNAWAY_MPS2: Final = 1e4
"""Above every acceleration of a stable body."""


@dataclass(frozen=True, eq=False)
class Party:
    """One person in several events, with the same effects and background in each; all at once."""

    person: Person
    events: Sequence[Event]
    effects: tuple[Effect, ...] = ()
    background: Background = NOTHING
    mechanisms: tuple[Mechanism, ...] = ()


@dataclass(frozen=True, eq=False)
class Moved:
    """Motion of a party: accelerations (n, 6) m/s^2 of each event, upward, at `HELD_HZ`.

    reach_m, rise_m, rate_mps (events, 6): compression of joints, rise of segments, rms rate of joints.
    """

    accel_mps2: tuple[Floats, ...]
    reach_m: Floats
    rise_m: Floats
    rate_mps: Floats


@np.errstate(over="ignore", invalid="ignore")  # of bodies that run away, which is looked for behind it
def moved(parties: Sequence[Party]) -> list[Moved]:
    """Move all parties from rest; events shorter than the longest go on at rest, which is cut off again."""
    flow = _Flow(parties)
    steps, first_end, rows = (len(flow.base) - 1) // 2, flow.last.min(), flow.rows
    accel = np.empty((steps + 1, rows, 6))
    reach, rise, squares = (np.zeros((rows, 6)) for _ in range(3))
    state, stages = np.zeros(flow.size), np.empty((4, flow.size))
    first, second, third, fourth = stages
    weights = STEP_S / 6.0 * np.array([1.0, 2.0, 2.0, 1.0])
    for n in range(steps + 1):
        flow.slope(2 * n, state, first)
        flow.remember(n, state, first)
        accel[n] = flow.upward
        # Beyond the longest event of a party nothing counts: a person does not depend on the others.
        on = slice(None) if n <= first_end else flow.last >= n
        reach[on] = np.minimum(reach[on], flow.stretch[on])
        rise[on] = np.maximum(rise[on], state[: 6 * rows].reshape(rows, 6)[on])
        squares[on] += flow.rate[on] ** 2
        if n == steps:
            break
        flow.slope(2 * n + 1, state + 0.5 * STEP_S * first, second)
        flow.slope(2 * n + 1, state + 0.5 * STEP_S * second, third)
        flow.slope(2 * n + 2, state + STEP_S * third, fourth)
        state += weights @ stages
    rate = np.sqrt(squares / (flow.last[:, None] + 1))
    return [
        Moved(
            tuple(accel[: len(event.accel_mps2[::2]), r.start + i].copy() for i, event in enumerate(party.events)),
            -reach[r], rise[r], rate[r],
        )
        for r, party in zip(flow.parts, parties, strict=True)
    ]  # fmt: skip


def runs_away(accel_mps2: Sequence[Floats]) -> bool:
    """Whether a body exceeds `RUNAWAY_MPS2` in any of its events."""
    return not all(np.abs(accel).max() < RUNAWAY_MPS2 for accel in accel_mps2)  # NaN is not below either


def _level(signals: Sequence[Floats], count: int) -> Floats:
    """Signals (n, ...) of different lengths side by side, (count, rows, ...); their last value goes on."""
    out = np.empty((count, len(signals), *signals[0].shape[1:]))
    for i, one in enumerate(signals):
        out[: len(one), i] = one
        out[len(one) :, i] = one[-1]
    return out


class _Merged:
    """One kind of mechanism in all parties that have it, as one: its rows, and its states' place."""

    def __init__(self, members: Sequence[tuple[Mechanism, Party, slice]], begin: int, halves: int) -> None:
        ones = [one for one, _, _ in members]
        events = [event for _, party, _ in members for event in party.events]
        self.mechanism = type(ones[0]).merged(ones, [len(party.events) for _, party, _ in members])
        self.rows = np.concatenate([np.arange(rows.start, rows.stop) for _, _, rows in members])
        self.shape = (len(events), self.mechanism.states)
        self.place = slice(begin, begin + self.shape[0] * self.shape[1])
        self.signals = _level([one.signals(event) for one, party, _ in members for event in party.events], halves)
        self.begin_s = np.array([event.begin_s for event in events])
        self.whole_s = np.array([event.whole_s for event in events])
        self.now = Moment()

    def act(self, half: int, seen: Floats, base: Floats, forces: Floats, own: Floats) -> Floats | None:
        """Add tensions and pushes to forces (rows, 12); the rates of the own states.

        seen: x, v, stretch and rate (4, rows, 6).
        """
        now = self.now
        now.x, now.v, now.stretch, now.rate = seen.take(self.rows, axis=1)
        now.base_mps2, now.signal = base.take(self.rows), self.signals[half]
        now.share = (self.begin_s + 0.5 * half * STEP_S) / self.whole_s
        added = np.zeros((self.shape[0], 12))
        now.joint_n, now.up_n = added[:, :6], added[:, 6:]
        rates = self.mechanism.act(now, own.reshape(self.shape))
        forces[self.rows] += added
        return rates


def _by_kind(parties: Sequence[Party], parts: Sequence[slice]) -> Iterator[list[tuple[Mechanism, Party, slice]]]:
    """The members of each kind of mechanism in the body."""
    members = [(one, p, rows) for p, rows in zip(parties, parts, strict=True) for one in p.mechanisms if one.in_body]
    for kind in dict.fromkeys(type(one) for one, _, _ in members):
        yield [member for member in members if type(member[0]) is kind]


def _in_body(effect: Effect) -> bool:
    """Whether an effect can change the motion of the body other than by its seat."""
    kind = type(effect)
    return effect.states > 0 or kind.act is not Effect.act or kind.offset is not Effect.offset


class _Acting:
    """One effect of one party: its rows, its states' place behind the bodies', its moment and its memory."""

    def __init__(self, effect: Effect, party: Party, rows: slice, begin: int, halves: int) -> None:
        count = len(party.events)
        self.effect, self.rows, self.shape = effect, rows, (count, effect.states)
        self.place = slice(begin, begin + count * effect.states)
        self.signals = _level([effect.signals(event, party.person) for event in party.events], halves)
        self.begin_s = np.array([event.begin_s for event in party.events])
        self.whole_s = max(event.whole_s for event in party.events)
        self.now = Moment()
        self.now.person = party.person
        self.memory = np.zeros((2, halves // 2 + 2, *self.shape)) if effect.delay_s else None

    def see(self, flow: _Flow) -> None:
        """Look at the own rows of a flow, which writes each state of the body into the same arrays."""
        now = self.now
        now.x, now.v, now.stretch, now.rate = flow.seen[:, self.rows]
        now.joint_n, now.up_n, now.base_mps2 = flow.joint[self.rows], flow.up[self.rows], flow.base_now[self.rows]

    def look(self, half: int) -> None:
        """Take in what is known before the joints pull."""
        now, now.signal = self.now, self.signals[half]
        since_s = 0.5 * half * STEP_S
        now.time_s = self.begin_s + since_s
        now.share, now.moving_s = now.time_s / self.whole_s, since_s - REST_S[0]
        if self.memory is not None:
            now.late = self._recalled(0.5 * half - self.effect.delay_s / STEP_S)

    def _recalled(self, steps: float) -> Floats:
        """The own states so many steps after the beginning, (r, s): Hermite's cubic between two of them."""
        if steps <= 0.0:
            return np.zeros(self.shape)
        n, u = int(steps), steps - int(steps)
        values, rates = self.memory
        w = u * u * (3.0 - 2.0 * u)
        slopes = u * (1.0 - u) * ((1.0 - u) * rates[n] - u * rates[n + 1])
        return (1.0 - w) * values[n] + w * values[n + 1] + STEP_S * slopes


class _Flow:
    """All parties as one system: rows of bodies, then the effects' states, in one flat vector."""

    def __init__(self, parties: Sequence[Party]) -> None:
        counts = [len(party.events) for party in parties]
        ends = np.cumsum(counts)
        self.rows = int(ends[-1])
        self.parts = [slice(int(end) - count, int(end)) for end, count in zip(ends, counts, strict=True)]

        def each(values: list[Floats]) -> Floats:
            return np.repeat(np.array(values), counts, axis=0)

        people, behind = [p.person for p in parties], [p.background for p in parties]
        self.stiffness = each([p.stiffness_n_per_m for p in people])
        self.stiffening = each([p.stiffness_n_per_m * p.stiffening_per_m for p in people])
        self.damping = each([p.damping_ns_per_m for p in people])
        self.per_kg = 1.0 / each([p.inertia_kg * b.mass for p, b in zip(people, behind, strict=True)])
        self.alpha = each([np.array([p.alpha_r]) for p in people])
        # Shares of springs and dampers, for rows with a `Background`.
        self.bent = each([p.stiffness_n_per_m * b.bent for p, b in zip(people, behind, strict=True)])
        self.cubic = each([p.stiffness_n_per_m * b.cubic for p, b in zip(people, behind, strict=True)])
        self.squared = each([p.damping_ns_per_m * b.squared for p, b in zip(people, behind, strict=True)])
        self.friction = each([b.friction_n for b in behind])
        self.per_m, self.per_mps = each([1.0 / b.reach_m for b in behind]), each([1.0 / b.speed_mps for b in behind])
        self.plain = all(b is NOTHING for b in behind)
        seats = [
            event.accel_mps2[:, 2] + sum(effect.base_mps2(event) for effect in party.effects)
            for party in parties
            for event in party.events
        ]
        longest = max(map(len, seats))
        ends_at = [(max(len(event.accel_mps2) for event in party.events) + 1) // 2 for party in parties]
        self.last = np.repeat(ends_at, counts)
        """The last step of each row's party."""
        # One sample of rest, so that it is rest that goes on; and an even number of half steps.
        self.base = _level([np.append(seat, 0.0) for seat in seats], longest + 1 + longest % 2)
        self.acting: list[_Acting] = []
        self.size = 12 * self.rows
        for party, rows in zip(parties, self.parts, strict=True):
            for effect in filter(_in_body, party.effects):
                self.acting.append(_Acting(effect, party, rows, self.size, len(self.base)))
                self.size += len(party.events) * effect.states
        self.merged: list[_Merged] = []
        for members in _by_kind(parties, self.parts):
            self.merged.append(_Merged(members, self.size, len(self.base)))
            self.size = self.merged[-1].place.stop
        self.upward, self.seen = np.empty((self.rows, 6)), np.empty((4, self.rows, 6))
        self.joint, self.up = np.empty((2, self.rows, 6))
        self.base_now = np.empty(self.rows)
        self.stretch, self.rate = self.seen[2:]
        for one in self.acting:
            one.see(self)

    def slope(self, half: int, state: Floats, out: Floats) -> None:
        """The state's rate after so many half steps; leaves stretch, rate and upward acceleration behind."""
        middle = 6 * self.rows
        x, v, stretch, rate = self.seen
        x[:], v[:] = state[: 2 * middle].reshape(2, -1, 6)
        base, joint, up = self.base_now, self.joint, self.up
        base[:] = self.base[half]
        stretch[:, 0], rate[:, 0] = x[:, 0], v[:, 0]
        np.subtract(x[:, 1:], x[:, :-1], out=stretch[:, 1:])
        np.subtract(v[:, 1:], v[:, :-1], out=rate[:, 1:])
        for one in self.acting:
            one.look(half)
            moved = one.effect.offset(one.now, state[one.place].reshape(one.shape))
            if moved:
                stretch[one.rows, moved[0]] += moved[1]
                rate[one.rows, moved[0]] += moved[2]
        joint[:] = self._joints(stretch, rate)
        behind = self._behind(half, base, state, out) if self.merged else None
        if behind is not None:
            joint += behind[:, :6]
        np.negative(joint, out=up)
        up[:, :-1] += joint[:, 1:]
        if behind is not None:
            up += behind[:, 6:]
        for one in self.acting:
            own = one.effect.act(one.now, state[one.place].reshape(one.shape))
            if own is not None:
                out[one.place] = own.ravel()
        np.multiply(up, self.per_kg, out=self.upward)
        self.upward -= self.alpha * v
        out[:middle] = state[middle : 2 * middle]
        np.subtract(self.upward, base[:, None], out=out[middle : 2 * middle].reshape(-1, 6))

    def _behind(self, half: int, base: Floats, state: Floats, out: Floats) -> Floats:
        """Tensions of the joints and pushes on the segments (rows, 12) of the mechanisms."""
        forces = np.zeros((self.rows, 12))
        for one in self.merged:
            own = one.act(half, self.seen, base, forces, state[one.place])
            if own is not None:
                out[one.place] = own.ravel()
        return forces

    def _joints(self, stretch: Floats, rate: Floats) -> Floats:
        """Tension of the joints, (rows, 6)."""
        pull = (self.stiffness + self.stiffening * np.abs(stretch)) * stretch + self.damping * rate
        if self.plain:
            return pull
        u, w = self.per_m * stretch, self.per_mps * rate
        size = np.abs(w)
        pull += stretch * u * (self.bent + self.cubic * u) / (1.0 + u * u)
        pull += self.squared * rate * size / (1.0 + size)
        return pull + self.friction * w / np.sqrt(w * w + 0.0225)

    def remember(self, step: int, state: Floats, slope: Floats) -> None:
        """Keep the states of effects that look back."""
        for one in self.acting:
            if one.memory is not None:
                one.memory[0, step] = state[one.place].reshape(one.shape)
                one.memory[1, step] = slope[one.place].reshape(one.shape)
