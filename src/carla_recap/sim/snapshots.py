"""Snapshots of a world, and the frames of a recording that they become: later, many at once, and without the world."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.frame import LAST_FRAME_DURATION, Frame, Packet
from carla_recap.records import FRAME_END, ORDER, UE4
from carla_recap.replay.rows import numbers
from carla_recap.sim.poses import CM_PER_M

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.void]
    States = dict[tuple[str, str], NDArray[Any]]

TYPES: Final = {UE4[id].name: UE4[id] for id in ORDER}
"""The types of records in the order in which CARLA writes their packets."""
_END: Final = Packet(FRAME_END, UE4[FRAME_END], b"")
_ROLL_PITCH_YAW: Final = [2, 0, 1]
"""Where they are in the rotations of `Movers`."""
_MOVER: Final = ("position", "rotation", "velocity", "angular_velocity")
COLUMNS: Final = {
    **{("vehicles", name): ("", "") for name in _MOVER},
    **{("walkers", name): ("", "") for name in _MOVER},
    ("signals", "frozen"): ("light_states", "frozen"),
    ("signals", "elapsed"): ("light_states", "elapsed"),
    ("signals", "state"): ("light_states", "state"),
    ("vehicles", "steer"): ("vehicle_controls", "steer"),
    ("vehicles", "throttle"): ("vehicle_controls", "throttle"),
    ("vehicles", "brake"): ("vehicle_controls", "brake"),
    ("vehicles", "hand_brake"): ("vehicle_controls", "hand_brake"),
    ("vehicles", "gear"): ("vehicle_controls", "gear"),
    ("vehicles", "light_state"): ("vehicle_lights", "flags"),
    ("walkers", "speed"): ("walker_controls", "speed"),
}
"""Columns of a world, and the field of a record that each is told in, if it is told as it is."""
OTHER_POSES: Final = ("others", "pose")
"""Where those are who are neither vehicles nor walkers."""


@dataclass(slots=True, eq=False)
class Snapshot:
    """A world at the end of a tick.

    Attributes:
        index: Its place in the recording, from 0.
        elapsed: Seconds since the recording began.
        time: Seconds since the episode began.
        events: What happened, as packets by type; what did not is missing.
        lineup: Who is there.
        states: Where they are and what they do: columns of the world by their holders and names; see `COLUMNS`.
        duration: Seconds until the next one.
    """

    index: int
    elapsed: float
    time: float
    events: dict[str, Packet]
    lineup: Lineup
    states: States
    duration: float = LAST_FRAME_DURATION


class Lineup:
    """Who is in a world as long as nobody comes or goes, as ids.

    Args:
        placed: The actors whose places are told, in the order in which they came.
        vehicles: The vehicles.
        walkers: The walkers.
        others: Those with places that are neither.
        lights: The traffic lights.
        additional_data: Tell of velocities and the platform's clock, too.
    """

    def __init__(
        self,
        *,
        placed: list[int],
        vehicles: list[int],
        walkers: list[int],
        others: list[int],
        lights: list[int],
        additional_data: bool,
    ) -> None:
        place = {id: index for index, id in enumerate(placed)}
        self._places = [place[id] for id in (*vehicles, *walkers, *others)]
        self._ids = {
            "transforms": placed,
            "light_states": lights,
            "vehicle_controls": vehicles,
            "walker_controls": walkers,
            "vehicle_lights": vehicles,
            "velocities": [*vehicles, *walkers] if additional_data else [],
        }
        self._additional = additional_data
        self._blank: dict[str, Packet | None] = {
            name: Packet(type.id, type, records=type.records([]))
            if type.always and (additional_data or not type.additional)
            else None
            for name, type in TYPES.items()
        }

    def frames(self, snapshots: Sequence[Snapshot]) -> Iterator[Frame]:
        """The frames of snapshots of these actors."""
        columns = {key: np.stack([snapshot.states[key] for snapshot in snapshots]) for key in snapshots[0].states}
        arrays = {name: _blank(name, ids, len(snapshots)) for name, ids in self._ids.items() if ids}
        self._fill(arrays, columns)
        arrays["visual_time"] = _clock("visual_time", [snapshot.time for snapshot in snapshots])
        if self._additional:
            arrays["platform_time"] = _clock("platform_time", [snapshot.elapsed for snapshot in snapshots])
        for place, snapshot in enumerate(snapshots):
            packets = self._blank.copy()
            for name, array in arrays.items():
                packets[name] = Packet(TYPES[name].id, TYPES[name], records=array[place])
            packets |= snapshot.events
            told = [packet for packet in packets.values() if packet is not None]
            yield Frame(snapshot.index, snapshot.index + 1, snapshot.elapsed, snapshot.duration, [*told, _END])

    def _fill(self, arrays: dict[str, Array], columns: States) -> None:
        poses = [
            np.concatenate((columns[who, "position"] * CM_PER_M, columns[who, "rotation"][..., _ROLL_PITCH_YAW]), axis=-1)
            for who in ("vehicles", "walkers")
        ]
        numbers(arrays["transforms"])[:, self._places] = np.concatenate((*poses, columns[OTHER_POSES]), axis=1)
        if "velocities" in arrays:
            rows = numbers(arrays["velocities"])
            for part, name in ((slice(0, 3), "velocity"), (slice(3, 6), "angular_velocity")):
                rows[..., part] = np.concatenate((columns["vehicles", name], columns["walkers", name]), axis=1)
        for (holder, name), (type, field) in COLUMNS.items():
            if type in arrays and field:
                arrays[type][field] = columns[holder, name]
        if "walker_controls" in arrays:
            arrays["walker_controls"]["speed"] *= CM_PER_M


def _blank(name: str, ids: list[int], count: int) -> Array:
    records = np.zeros((count, len(ids)), TYPES[name].dtype)
    records["id"] = ids
    return records


def _clock(name: str, seconds: list[float]) -> Array:
    records = np.zeros((len(seconds), 1), TYPES[name].dtype)
    records["seconds"][:, 0] = seconds
    return records


def develop(snapshots: Sequence[Snapshot]) -> Iterator[Frame]:
    """The frames of snapshots."""
    for lineup, group in groupby(snapshots, lambda snapshot: snapshot.lineup):
        yield from lineup.frames(list(group))
