"""The summary of a recording: who is in it, how far the hero drives, and how often something goes wrong."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from carla_recap.model.lives import ROAD_USERS, heroes_of
from carla_recap.queries import Answer
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.recorded_actors import actors
from carla_recap.queries.sensors import sensors
from carla_recap.tables.trajectories import trajectories
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorLife


@dataclass(frozen=True, slots=True)
class HeroSummary:
    """How the hero moves.

    Attributes:
        id: Its actor id.
        type_id: Its blueprint.
        time: The time between its first and its last pose, in s.
        distance: The distance that it covers, in m; jumps do not count.
        top_speed: Its greatest speed, in m/s; NaN if none is known.
    """

    id: int
    type_id: str
    time: float
    distance: float
    top_speed: float


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What a recording contains.

    Attributes:
        map: The name of the map.
        frames: The number of frames.
        duration: The elapsed time of the last frame, in s.
        actors: The number of actors by kind, vehicles and walkers first.
        hero: The first hero that has poses; None if there is none.
        incidents: The number of incidents by kind, of the kinds that occur.
        sensors: The types of the sensors whose data it has, by id.
    """

    map: str
    frames: int
    duration: float
    actors: dict[str, int]
    hero: HeroSummary | None
    incidents: dict[str, int]
    sensors: dict[str, str]


class Summaries(Answer[RecordingSummary]):
    """The summary of a recording, as the only row.

    Attributes:
        others: The number of actors of the kind `other` by blueprint, the most frequent first.
    """

    row_type = RecordingSummary
    row_units: ClassVar = {"duration": "s"}
    others: Mapping[str, int] = MappingProxyType({})


def summary(source: Reader, options: IncidentOptions | None = None) -> Summaries:
    """Return the summary of a recording.

    Args:
        source: The recording.
        options: Which incidents to count; None: all kinds. Those of the road are left out if the map is unknown.

    Raises:
        RecapError: See `carla_recap.queries.incidents.incidents`.
        FormatError: The file contradicts its format.

    Warns:
        RecapWarning: The map is unknown.
    """
    found = Counter(incident.kind for incident in incidents(source, options or IncidentOptions(kinds="all")))
    lives = actors(source)
    kinds = Counter(life.kind for life in lives)
    heroes = (_hero(source, life) for life in heroes_of(lives))
    extent = source.extent()
    row = RecordingSummary(
        readable(source.header.map_name),
        extent.frames,
        extent.duration,
        {kind: count for kind in (*ROAD_USERS, *kinds) if (count := kinds.get(kind))},
        next((hero for hero in heroes if hero is not None), None),
        {kind: found[kind] for kind in KINDS if found[kind]},
        {sensor.id: sensor.type for sensor in sensors(source)},
    )
    found_summary = Summaries([row], source, compat=False)
    found_summary.others = dict(Counter(life.type_id for life in lives if life.kind == "other").most_common())
    return found_summary


def _hero(source: Reader, life: ActorLife) -> HeroSummary | None:
    """Return how a hero moves; None if it has no pose."""
    path = trajectories(source, {life.id}).get(life.id)
    if path is None:
        return None
    path = path.during(life.spawned_at, life.end)
    if not len(path):
        return None
    steps, speed = path.steps, path.speed
    distance, top_speed = np.nansum(steps).item(), np.fmax.reduce(speed, initial=math.nan).item()
    return HeroSummary(life.id, life.type_id, (path.time[-1] - path.time[0]).item(), distance, top_speed)
