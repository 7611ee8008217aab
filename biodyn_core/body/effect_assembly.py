"""Effect assembly: the effects of a chain in its integrator, with their constants, states and memory."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from biodyn_core.base.arrays import Floats
from biodyn_core.base.errors import InputError
from biodyn_core.base.segments import N_SEGMENTS
from biodyn_core.effects import Effect
from biodyn_core.kernels.generated import ANYWHERE, Piece, Role, integrator

_NO_DRIVE: Final = np.empty((0, 0))


@dataclass(frozen=True)
class Element:
    """An effect in a chain: its segment or joint, 0 to 5, or the spread of its force over all six, and its constants.

    channels: inputs beyond the seat's vertical; delay_s: of its memory; stiffness and damping: the largest that it may
    add there; own_rate_per_s: the largest eigenvalue of its own states.
    """

    effect: Effect
    index: int
    constants: tuple[float, ...]
    channels: tuple[str, ...]
    delay_s: float
    own_rate_per_s: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    spread: tuple[float, ...]


class EffectAssembly:
    """The integrator with some elements, for one step; its constants p also hold the elements' memory."""

    def __init__(self, elements: Sequence[Element], step_s: float) -> None:
        self.channels = tuple(dict.fromkeys(name for element in elements for name in element.channels))
        pieces = [_piece(element, self.channels, step_s) for element in elements]
        self.integrate = integrator(pieces)
        self.states = sum(piece.all_states for piece in pieces)
        self.p = np.concatenate([np.empty(0), *map(_constants, elements, pieces, [step_s] * len(pieces))])
        self._at_rest = self.p.copy()
        self._driven = _drive_states(pieces)

    def begin(self, states: Floats, drive: Floats) -> None:
        """Put states (s,) and memory to rest, with drives at their first sample, a row of drive (n, d)."""
        states[:] = 0.0
        self.p[:] = self._at_rest
        for place, column in self._driven:
            states[place] = drive[0, column]

    def drive(self, channels: Mapping[str, Floats] | None) -> Floats:
        """The channels that the elements need, (n, d), or (0, 0); raises InputError for a missing one."""
        if not self.channels:
            return _NO_DRIVE
        found = channels or {}
        for name in self.channels:
            if name not in found:
                raise InputError(f"an effect needs the channel {name}, which is not measured here")
        # A masked sample is zero input.
        return np.ascontiguousarray(np.column_stack([np.nan_to_num(found[name]) for name in self.channels]))


def _piece(element: Element, channels: Sequence[str], step_s: float) -> Piece:
    """An element's part of the integrator."""
    effect = element.effect
    role: Role = "force on a segment" if effect.place == "segment" else "force of a joint"
    if effect.limit is not None:
        role = "limit of a joint"
    function = effect.force or effect.limit
    assert function is not None, effect.name
    drives = tuple(channels.index(name) for name in element.channels)
    past = _past(effect, step_s)
    at = ANYWHERE if element.spread else element.index
    return Piece(role, function, at, effect.states, N_SEGMENTS + bool(past) + len(element.constants), drives, past)


def _past(effect: Effect, step_s: float) -> int:
    """Steps that cover the longest delay, the same for every delay, so that one compiled integrator serves all."""
    longest_s = next((p.upper for p in effect.parameters if p.name == effect.delay), 0.0)
    return math.ceil(longest_s / step_s) + 3 if longest_s > 0.0 else 0


def _constants(element: Element, piece: Piece, step_s: float) -> Floats:
    steps = (max(element.delay_s / step_s, 1.0),) if piece.past else ()
    here = element.spread or np.arange(N_SEGMENTS) == element.index
    return np.array([*here, *steps, *element.constants, *[0.0] * piece.memory])


def _drive_states(pieces: Sequence[Piece]) -> list[tuple[int, int]]:
    """(state, column) of the states that begin at a column of the drive."""
    found, state = [], 0
    for piece in pieces:
        found += [(state + i, column) for i, column in enumerate(piece.drives)]
        state += piece.all_states
    return found
