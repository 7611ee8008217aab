"""A mechanism of the background: one way in which a whole body or all its sensors differ from the model."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from world.effects.effect import Moment, Person, SensorHooks
from world.effects.event import Event

if TYPE_CHECKING:
    from typing_extensions import Self

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mechanism(SensorHooks):
    """Parameters of one body as arrays: (6,) for joints or segments, (7,) for sensors by `ride.SENSORS`.

    states: the number of its states in the body, which begin at 0. A mechanism of the body (`in_body`) acts on many
    bodies at once, so its law accepts parameters with a further first axis, one row for each body in each event.
    """

    in_body: ClassVar[bool] = False
    states: ClassVar[int] = 0

    @classmethod
    def of(cls, person: Person, scale: float, rng: np.random.Generator) -> Self:
        """Draw the parameters for a person; every deviation is proportional to scale or limited, 1 being typical."""
        raise NotImplementedError

    @classmethod
    def merged(cls, ones: Sequence[Mechanism], counts: Sequence[int]) -> Self:
        """Several bodies as one, with counts[i] rows for the body of ones[i]."""

        def rows(name: str) -> Any:
            return np.repeat(np.array([getattr(one, name) for one in ones]), counts, axis=0)

        return cls(**{field.name: rows(field.name) for field in dataclasses.fields(cls)})

    def signals(self, event: Event) -> Floats:
        """Signals of one body from outside on the grid of the event, (n, c)."""
        return np.empty((len(event.accel_mps2), 0))

    def act(self, now: Moment, own: Floats) -> Floats | None:
        """Add tensions to `now.joint_n` and forces from outside to `now.up_n`; return the rates (r, s) of own (r, s).

        Both begin at 0. Of `now`, x, v, stretch, rate, base_mps2, signal and share are set.
        """
        return None


def half_normal(rms: float, scale: float, rng: np.random.Generator, size: int | tuple[int, ...] = 6) -> Floats:
    """Positive sizes of this rms at scale 1."""
    return scale * rms * np.abs(rng.standard_normal(size))


def log_uniform(low: float, high: float, rng: np.random.Generator, size: int | tuple[int, ...] = 6) -> Floats:
    """Evenly in the logarithm."""
    return np.exp(rng.uniform(np.log(low), np.log(high), size))
