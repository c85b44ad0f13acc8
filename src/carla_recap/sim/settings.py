"""How a world runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(slots=True)
class Settings:
    """The settings of a world, with CARLA's names.

    Attributes:
        synchronous_mode: Whether only `tick` moves the world; `run_realtime` is what does it otherwise.
        no_rendering_mode: Accepted; nothing is ever rendered.
        fixed_delta_seconds: The length of a tick; None for one as long as the caller says.
        substepping: Whether long ticks are simulated in several steps.
        max_substep_delta_time: The longest step, in s.
        max_substeps: The most steps of a tick.
        collisions_of: Whose collisions are noticed, besides those of actors with a collision sensor.
    """

    synchronous_mode: bool = True
    no_rendering_mode: bool = False
    fixed_delta_seconds: float | None = 0.05
    substepping: bool = True
    max_substep_delta_time: float = 0.05
    max_substeps: int = 10
    collisions_of: Literal["heroes", "all"] = "heroes"
