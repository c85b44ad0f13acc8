"""The settings of a world."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from carla_recap.sim.errors import SimError
from carla_recap.sim.validation import expect_seconds

_COLLISIONS_OF = ("heroes", "all")


@dataclass(slots=True)
class Settings:
    """The settings of a world, with CARLA's names.

    Attributes:
        synchronous_mode: Whether the world only advances by `tick`; without it, by `run_realtime`.
        no_rendering_mode: Accepted without effect, since nothing is rendered.
        fixed_delta_seconds: The length of a tick, above 0 and at most 10 s; None if the caller chooses it.
        substepping: Whether long ticks are simulated in several steps.
        max_substep_delta_time: The greatest length of a step in s, above 0.
        max_substeps: The greatest number of steps in a tick.
        collisions_of: The actors whose collisions are reported, in addition to those with a collision sensor.

    Raises:
        SimError: A value is out of range, when it is set.
    """

    synchronous_mode: bool = True
    no_rendering_mode: bool = False
    fixed_delta_seconds: float | None = 0.05
    substepping: bool = True
    max_substep_delta_time: float = 0.05
    max_substeps: int = 10
    collisions_of: Literal["heroes", "all"] = "heroes"

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "max_substep_delta_time" or (name == "fixed_delta_seconds" and value is not None):
            expect_seconds(name, value)
        if name == "collisions_of" and value not in _COLLISIONS_OF:
            raise SimError(f"{name}: {' or '.join(_COLLISIONS_OF)} was expected, found {value!r}")
        object.__setattr__(self, name, value)
