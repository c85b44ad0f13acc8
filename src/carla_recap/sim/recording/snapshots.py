"""Snapshots of a world, on strips, and the frames of a recording that they become: later, all at once, without the world."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.frame import LAST_FRAME_DURATION, Block, Packet, Run
from carla_recap.payload import EMPTY_LIST, pack
from carla_recap.records import FRAME_END, ORDER, UE4, Framing
from carla_recap.replay.rows import numbers
from carla_recap.sim.recording.poses import CM_PER_M

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.void]
    States = dict[tuple[str, str], NDArray[Any]]

TYPES: Final = {UE4[id].name: UE4[id] for id in ORDER}
"""The types of records in the order in which CARLA writes their packets."""
_SLOTS: Final = {name: slot for slot, name in enumerate(TYPES)}
_END: Final = Packet(FRAME_END, UE4[FRAME_END], b"")
_ROLL_PITCH_YAW: Final = [2, 0, 1]
"""Where they are in the rotations of `Movers`."""
COLUMNS: Final = {
    **{(who, name): ("transforms", "") for who in ("vehicles", "walkers") for name in ("position", "rotation")},
    **{(who, name): ("velocities", "") for who in ("vehicles", "walkers") for name in ("velocity", "angular_velocity")},
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
"""Columns of a world, and the type and field of the records that each is told in; no field where it is not told as it is."""
OTHER_POSES: Final = ("others", "pose")
"""Where those are who are neither vehicles nor walkers."""
_REAL: Final = np.dtype(np.float32)
_DTYPES: Final = {column: UE4.named(type).dtype[field] if field else _REAL for column, (type, field) in COLUMNS.items()} | {
    OTHER_POSES: _REAL
}
"""What records have, which is less than what a world reckons with."""
_IN_CM: Final = "position"


@dataclass(slots=True, eq=False)
class Moment:
    """When a snapshot was taken, and what had happened by then.

    Attributes:
        index: The place of the snapshot in the recording, from 0.
        elapsed: Seconds since the recording began.
        time: Seconds since the episode began.
        events: What happened since the snapshot before, as packets by type; what did not is missing.
        duration: Seconds until the next snapshot.
    """

    index: int
    elapsed: float
    time: float
    events: dict[str, Packet]
    duration: float = LAST_FRAME_DURATION


class Strip:
    """Snapshots in a row of the same actors.

    Args:
        lineup: Who is there.
        states: Columns like those that will be added: where everybody is, and what they do; see `COLUMNS`.
        length: How many snapshots there is room for.

    Attributes:
        moments: When the snapshots were taken.
    """

    def __init__(self, lineup: Lineup, states: States, length: int) -> None:
        self.moments: list[Moment] = []
        self._lineup = lineup
        self._length = length
        self._states: States = {key: np.empty((length, *column.shape), _DTYPES[key]) for key, column in states.items()}

    def __getstate__(self) -> tuple[Any, ...]:
        """What another process needs, in few and small pieces."""
        moments = [(told.index, told.elapsed, told.time, told.events, told.duration) for told in self.moments]
        return self._lineup, self._length, self._columns, moments

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self._lineup, self._length, self._states, moments = state
        self.moments = [Moment(*moment) for moment in moments]

    @property
    def is_full(self) -> bool:
        """Whether there is no more room."""
        return len(self.moments) == self._length

    def add(self, moment: Moment, states: States) -> None:
        """Add a snapshot."""
        place = len(self.moments)
        for key, column in states.items():
            if key[1] == _IN_CM:
                np.multiply(column, CM_PER_M, out=self._states[key][place], casting="same_kind")
            else:
                self._states[key][place] = column
        self.moments.append(moment)

    def runs(self) -> Iterator[Run]:
        """The snapshots as frames."""
        return self._lineup.runs(self.moments, self._columns)

    @property
    def _columns(self) -> States:
        return {key: columns[: len(self.moments)] for key, columns in self._states.items()}


class Lineup:
    """Who is in a world as long as nobody comes or goes, as ids.

    Args:
        placed: The actors whose places are told, in the order in which they came.
        vehicles: The vehicles.
        walkers: The walkers.
        others: Those with places that are neither.
        lights: The traffic lights.
        additional_data: Tell of velocities and the platform's clock, too.

    Attributes:
        columns: Which columns of the world are told; see `COLUMNS`.
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
        self.columns = [column for column, (type, _) in COLUMNS.items() if self._ids[type]]
        self._additional = additional_data

    def runs(self, moments: list[Moment], columns: States) -> Iterator[Run]:
        """The frames of snapshots of these actors: where something happened, a frame is a run of its own.

        Args:
            moments: When the snapshots were taken.
            columns: What they show, a row for each; see `COLUMNS`.
        """
        packets = self._packets(moments, columns)
        for eventful, group in groupby(range(len(moments)), key=lambda place: bool(moments[place].events)):
            places = list(group)
            for part in [[place] for place in places] if eventful else [places]:
                yield _run(moments, part, packets)

    def _packets(self, moments: list[Moment], columns: States) -> list[Packet | Block | None]:
        """What is told in all frames, in the order of `TYPES`; None where only events are told."""
        forms = {name: form.repeat(len(moments)) for name, form in self._forms.items()}
        arrays = {name: form["records"] for name, form in forms.items()}
        self._fill(arrays, columns)
        for name in self._clocks:
            seconds = [moment.elapsed if name == "platform_time" else moment.time for moment in moments]
            arrays[name]["seconds"][:, 0] = seconds
        packets: list[Packet | Block | None] = list(self._blank)
        for name, form in forms.items():
            packets[_SLOTS[name]] = Block(TYPES[name], form.view(np.uint8).data, form.itemsize, arrays[name])
        return packets

    @property
    def _clocks(self) -> list[str]:
        return ["visual_time", "platform_time"] if self._additional else ["visual_time"]

    @cached_property
    def _blank(self) -> list[Packet | None]:
        """What each frame has when nothing has happened, in the order of `TYPES`."""
        return [
            Packet(type.id, type, EMPTY_LIST, type.records([]))
            if type.always and (self._additional or not type.additional)
            else None
            for type in TYPES.values()
        ]

    @cached_property
    def _forms(self) -> dict[str, Array]:
        """What the payloads of all frames have in common, by type: number and ids of the records, with blanks between."""
        forms = {name: _form(name, "id", ids) for name, ids in self._ids.items() if ids}
        return forms | {name: _form(name, "seconds", [0.0]) for name in self._clocks}

    def _fill(self, arrays: dict[str, Array], columns: States) -> None:
        poses = [
            np.concatenate((columns[who, "position"], columns[who, "rotation"][..., _ROLL_PITCH_YAW]), axis=-1)
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


def _run(moments: list[Moment], places: list[int], told: list[Packet | Block | None]) -> Run:
    """Frames in a row, in which the same happened: nothing, if they are more than one."""
    packets = list(told)
    for name, packet in moments[places[0]].events.items():
        packets[_SLOTS[name]] = packet
    mine = [moments[place] for place in places]
    return Run(
        [moment.index for moment in mine],
        [moment.elapsed for moment in mine],
        [moment.duration for moment in mine],
        [*(packet for packet in packets if packet is not None), _END],
        places[0],
    )


def _form(name: str, field: str, values: Sequence[float]) -> Array:
    """A payload as an array of one: its count, if it has one, and its records, of which one field is known."""
    type = TYPES[name]
    records = np.zeros(len(values), type.dtype)
    records[field] = values
    count = [("count", "<u2")] if type.framing is Framing.LIST else []
    return np.frombuffer(pack(type, records), [*count, ("records", type.dtype, (len(records),))])
