"""Batches of snapshots of a world, and the frames of a recording that they become: later, without the world.

A batch is what is sent to the process that writes the recording: columns for a set of actors that stays the same, in the
precision of the recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.batch import Batch, ConstantColumn, PackedColumn
from carla_recap.model.frame import LAST_FRAME_DURATION, Packet
from carla_recap.model.layout import EMPTY_LIST, Framing, pack
from carla_recap.model.records import CM_PER_M, FRAME_END, ORDER, UE4, UE5
from carla_recap.replay.selection import numbers

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.records import RecordType

    Array = NDArray[np.void]
    Columns = dict[tuple[str, str], NDArray[Any]]

TYPES: Final = tuple({table[id].name: table[id] for id in ORDER} for table in (UE4, UE5))
"""The record types in the order in which CARLA writes their packets: those of UE4, and those of UE5, which are wide."""
_SLOTS: Final = {name: slot for slot, name in enumerate(TYPES[0])}
_ENDS: Final = [Packet(FRAME_END, table[FRAME_END], b"") for table in (UE4, UE5)]
_ROLL_PITCH_YAW: Final = [2, 0, 1]
"""Their indices in the rotations of `MovingBodies`."""
COLUMNS: Final = {
    **{(owner, name): ("transforms", "") for owner in ("vehicles", "walkers") for name in ("position", "rotation")},
    **{(owner, name): ("velocities", "") for owner in ("vehicles", "walkers") for name in ("velocity", "angular_velocity")},
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
    ("others", "poses"): ("transforms", ""),
}
"""Columns of a world, and the record type and field of each; no field where the values are converted."""
_DTYPES: Final = [{column: types[type].dtype[field or "x"] for column, (type, field) in COLUMNS.items()} for types in TYPES]
"""The precision of records, which is less than that of a world where they are not wide."""
_IN_CM: Final = "position"


@dataclass(slots=True, eq=False)
class Timestamp:
    """The time of a snapshot, and what had happened by then.

    Attributes:
        elapsed: Seconds since the recording began.
        time: Seconds since the episode began.
        events: What happened since the last snapshot, as packets by type; types without records are missing.
        duration: Seconds until the next snapshot.
    """

    index: int
    elapsed: float
    time: float
    events: dict[str, Packet]
    duration: float = LAST_FRAME_DURATION


class SnapshotBatch:
    """Consecutive snapshots of the same actors, up to some number; their columns are those of `ActorSet.columns`."""

    def __init__(self, actors: ActorSet, columns: Sequence[NDArray[Any]], length: int) -> None:
        self.timestamps: list[Timestamp] = []
        self._actors = actors
        self._length = length
        self._columns: Columns = {
            key: np.empty((length, *column.shape), _DTYPES[actors.wide][key])
            for key, column in zip(actors.columns, columns, strict=True)
        }

    def __getstate__(self) -> tuple[Any, ...]:
        """Return what another process needs, in few and small pieces."""
        timestamps = [(each.index, each.elapsed, each.time, each.events, each.duration) for each in self.timestamps]
        return self._actors, self._length, self._filled, timestamps

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self._actors, self._length, self._columns, timestamps = state
        self.timestamps = [Timestamp(*timestamp) for timestamp in timestamps]

    @property
    def is_full(self) -> bool:
        """Whether no snapshot can be added."""
        return len(self.timestamps) == self._length

    def add(self, timestamp: Timestamp, columns: Sequence[NDArray[Any]]) -> None:
        """Add a snapshot: its time, and the columns of its actors; see `ActorSet.columns`."""
        index = len(self.timestamps)
        for (key, rows), column in zip(self._columns.items(), columns, strict=True):
            if key[1] == _IN_CM:
                np.multiply(column, CM_PER_M, out=rows[index], casting="same_kind")
            else:
                rows[index] = column
        self.timestamps.append(timestamp)

    def batches(self) -> Iterator[Batch]:
        """Yield the snapshots as frames."""
        return self._actors.batches(self.timestamps, self._filled)

    @property
    def _filled(self) -> Columns:
        return {key: columns[: len(self.timestamps)] for key, columns in self._columns.items()}


class ActorSet:
    """The actors of a world as long as none comes or goes, as ids; `columns` are those of the world that are recorded.

    Those with poses are in the order in which they were spawned; the others are those among them that are neither vehicles
    nor walkers. `wide` records have double precision.
    """

    def __init__(
        self,
        *,
        with_pose: list[int],
        vehicles: list[int],
        walkers: list[int],
        others: list[int],
        lights: list[int],
        additional_data: bool,
        wide: bool,
    ) -> None:
        self.wide = wide
        indices = {id: index for index, id in enumerate(with_pose)}
        self._indices = [indices[id] for id in (*vehicles, *walkers, *others)]
        self._ids = {
            "transforms": with_pose,
            "light_states": lights,
            "vehicle_controls": vehicles,
            "walker_controls": walkers,
            "vehicle_lights": vehicles,
            "velocities": [*vehicles, *walkers] if additional_data else [],
        }
        self.columns = [column for column, (type, _) in COLUMNS.items() if self._ids[type]]
        self._additional = additional_data

    def batches(self, timestamps: list[Timestamp], columns: Columns) -> Iterator[Batch]:
        """Yield the frames of snapshots of these actors; a frame with events is a batch of its own."""
        packets = self._packets(timestamps, columns)
        for has_events, group in groupby(range(len(timestamps)), key=lambda index: bool(timestamps[index].events)):
            indices = list(group)
            for part in [[index] for index in indices] if has_events else [indices]:
                yield _batch(timestamps, part, [*packets, _ENDS[self.wide]])

    def _packets(self, timestamps: list[Timestamp], columns: Columns) -> list[Packet | PackedColumn | None]:
        """Return the packets of all frames, in the order of `TYPES`; None for those that only events have."""
        templates = {name: template.repeat(len(timestamps)) for name, template in self._templates.items()}
        arrays = {name: template["records"] for name, template in templates.items()}
        self._fill(arrays, columns)
        for name in self._clocks:
            seconds = [each.elapsed if name == "platform_time" else each.time for each in timestamps]
            arrays[name]["seconds"][:, 0] = seconds
        packets: list[Packet | PackedColumn | None] = list(self._empty_packets)
        for name, template in templates.items():
            type, size = self._types[name], template.itemsize
            packets[_SLOTS[name]] = PackedColumn(type.id, type, size, template.view(np.uint8).data, 0, size, len(template))
        return packets

    @property
    def _types(self) -> Mapping[str, RecordType]:
        return TYPES[self.wide]

    @property
    def _clocks(self) -> list[str]:
        return ["visual_time", "platform_time"] if self._additional else ["visual_time"]

    @cached_property
    def _empty_packets(self) -> list[Packet | None]:
        """The packets of a frame without actors and events, in the order of `TYPES`."""
        return [
            Packet(type.id, type, EMPTY_LIST, type.records([]))
            if type.always and (self._additional or not type.additional)
            else None
            for type in self._types.values()
        ]

    @cached_property
    def _templates(self) -> dict[str, Array]:
        """Payloads by type with the number and the ids of the records, which all frames share."""
        templates = {name: _template(self._types[name], "id", ids) for name, ids in self._ids.items() if ids}
        return templates | {name: _template(self._types[name], "seconds", [0.0]) for name in self._clocks}

    def _fill(self, arrays: dict[str, Array], columns: Columns) -> None:
        poses = [
            np.concatenate((columns[owner, "position"], columns[owner, "rotation"][..., _ROLL_PITCH_YAW]), axis=-1)
            for owner in ("vehicles", "walkers")
        ]
        numbers(arrays["transforms"])[:, self._indices] = np.concatenate((*poses, columns["others", "poses"]), axis=1)
        if "velocities" in arrays:
            rows = numbers(arrays["velocities"])
            for part, name in ((slice(0, 3), "velocity"), (slice(3, 6), "angular_velocity")):
                rows[..., part] = np.concatenate((columns["vehicles", name], columns["walkers", name]), axis=1)
        for (owner, name), (type, field) in COLUMNS.items():
            if type in arrays and field:
                arrays[type][field] = columns[owner, name]
        if "walker_controls" in arrays:
            arrays["walker_controls"]["speed"] *= CM_PER_M


def _batch(timestamps: list[Timestamp], indices: list[int], packets: list[Packet | PackedColumn | None]) -> Batch:
    """Return consecutive frames: one, or several without events."""
    packets = list(packets)
    for name, packet in timestamps[indices[0]].events.items():
        packets[_SLOTS[name]] = packet
    start, stop = indices[0], indices[-1] + 1
    part = timestamps[start:stop]
    return Batch(
        part[0].index,
        np.array([each.index + 1 for each in part], np.uint64),
        np.array([each.elapsed for each in part]),
        np.array([each.duration for each in part]),
        [
            ConstantColumn(packet, len(part)) if isinstance(packet, Packet) else packet.sliced(start, stop)
            for packet in packets
            if packet is not None
        ],
    )


def _template(type: RecordType, field: str, values: Sequence[float]) -> Array:
    """Return a payload as an array of length one: its count, if it has one, and its records with one field filled in."""
    records = np.zeros(len(values), type.dtype)
    records[field] = values
    count = [("count", "<u2")] if type.framing is Framing.LIST else []
    return np.frombuffer(pack(type, records), [*count, ("records", type.dtype, (len(records),))])
