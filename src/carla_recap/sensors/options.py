"""Which part of a recording is sensed, on which actor, and how."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict

from carla_recap.errors import RecapError
from carla_recap.model.lives import HERO

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.model.lives import ActorName
    from carla_recap.rendering.camera import Quality


@dataclass(frozen=True, kw_only=True)
class SensingOptions:
    """Which part of a recording is sensed, on which actor, and how.

    Attributes:
        actor: The actor that carries the sensors: an id, or "hero": the one with that role name,
            whichever it is at a moment.
        start: The elapsed seconds to begin at; negative: before the end.
        duration: The seconds of the recording; 0: all of the rest.
        rate: The moments per second, between which and the recorded frames poses are interpolated; None: each frame.
        road_map: The town's map, an OpenDRIVE file or a folder of them; None: looked for in the usual folders.
        quality: The quality of RGB images: "low" has neither shadows nor smooth edges, "epic" has both.

    Raises:
        RecapError: The duration or the rate makes no sense.
    """

    actor: ActorName = HERO
    start: float = 0.0
    duration: float = 0.0
    rate: float | None = None
    road_map: Path | str | None = None
    quality: Quality = "epic"

    def __post_init__(self) -> None:
        if not self.duration >= 0:
            raise RecapError(f"a duration of {self.duration:g} s; 0 or more was expected")
        if self.rate is not None and not 0 < self.rate < math.inf:
            raise RecapError(f"a rate of {self.rate:g} per second; a number above 0 was expected")


class SensingKeywords(TypedDict, total=False):
    """The fields of `SensingOptions`, as keywords."""

    actor: ActorName
    start: float
    duration: float
    rate: float | None
    road_map: Path | str | None
    quality: Quality
