"""The state of a recording at any of its frames, as records with which another recording can begin."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.frame import Frame, Packet
from carla_recap.model.layout import MAX_COUNT
from carla_recap.model.records import FRAME_END, ORDER, Group
from carla_recap.replay.cursor import Cursor
from carla_recap.replay.selection import array, latest
from carla_recap.replay.state import ReplayState

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.layout import Records
    from carla_recap.model.records import Physics, RecordType, Spawn

_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_PROPERTIES: Final = ("bounding_boxes", "trigger_volumes", "light_times", "physics")  # an actor keeps its latest one
_RANKS: Final = {id: rank for rank, id in enumerate((*ORDER, FRAME_END))}


class InitialState:
    """The state that earlier frames have left: actors, destroyed actors, their properties, weather, lights, doors.

    It has neither the physics of UE5 builds, which are raw bytes, nor records that CARLA writes in each frame.
    """

    _next: Frame | None  # the first frame with events that has not been applied
    _applied: int  # the number of frames up to the latest one that has been applied
    _late: dict[int, int]  # the parents that `add_parents` adds, by actor

    def __init__(self, source: Reader) -> None:
        self.source = source
        self._table = source.header.table
        self._cursor = Cursor(source, self._new_state)
        self._rewind()

    @property
    def has_late_parents(self) -> bool:
        """Whether the frame after the completed one gets parents; see `add_parents`."""
        return bool(self._late)

    def complete(self, frame: Frame) -> Frame:
        """Return a frame with the records of the state before it, in each packet before its own records.

        The pose in a spawn is relative to the parent if the parent is recorded in the same frame. Parents that the source
        records later than the spawn are therefore left out here; see `add_parents`.

        Frames in ascending order are fastest.
        """
        if self._applied > frame.index:
            self._rewind()
        while self._next is not None and self._next.index < frame.index:
            self._apply(self._next)
            self._next = next(self._stream, None)
        self._late = self._late_parents(frame)
        packets = [_without_parents(packet, self._late) for packet in frame.packets]
        for name, records in self._records(frame):
            _insert(packets, self._table.named(name), records)
        return Frame(frame.index, frame.id, frame.elapsed, frame.duration, packets)

    def add_parents(self, frame: Frame) -> Frame:
        """Return the frame after a completed one, with the parents that were left out there."""
        late, self._late = self._late, {}
        changed = _spawned(frame).union(array(frame["destroyed"])["id"].tolist())
        packets = list(frame.packets)
        rows = [(id, parent) for id, parent in late.items() if id not in changed]
        _insert(packets, self._table.named("parented"), self._rows("parented", rows))
        return Frame(frame.index, frame.id, frame.elapsed, frame.duration, packets)

    def _rewind(self) -> None:
        types = [type.name for type in self._table if type.group is Group.EVENTS and type.name != "collisions"]
        self._stream = self.source.frames(types, sparse=True)
        self._next = next(self._stream, None)
        self._applied = 0
        self._late = {}
        self._state = self._new_state()
        self._properties: dict[str, dict[int, Any]] = defaultdict(dict)

    def _apply(self, frame: Frame) -> None:
        self._applied = frame.index + 1
        self._state.apply(frame)
        for packet in frame.packets:
            if packet.type is not None:
                self._update_properties(packet.type.name, packet.records)

    def _new_state(self) -> ReplayState:
        return ReplayState(self._table, ignore_hero=False, ignore_spectator=False)

    def _update_properties(self, name: str, records: Records) -> None:
        if name in ("spawned", "destroyed"):
            ids = [spawn.id for spawn in records] if name == "spawned" else array(records)["id"].tolist()
            for properties in self._properties.values():
                for id in ids:
                    properties.pop(id, None)
        elif name in _PROPERTIES:
            for index, record in enumerate(records):
                if isinstance(records, np.ndarray):
                    self._properties[name][int(record["id"])] = records[index : index + 1].copy()
                else:
                    self._properties[name][record.id] = record

    def _records(self, frame: Frame) -> Iterator[tuple[str, Records]]:
        """Yield the records of the state that a frame does not replace, by type."""
        state, new = self._state, _spawned(frame)
        actors = [actor for actor in state.actors.values() if actor.id not in new]
        earlier = self._latest("transforms", frame, new)
        poses = {pose["id"].item(): pose for pose in (*earlier, *latest(array(frame["transforms"])))}
        yield "spawned", [a.spawn if a.attached else _moved(a.spawn, poses.get(a.id)) for a in actors]
        destroyed = state.hidden[~np.isin(state.hidden, [*new, *array(frame["destroyed"])["id"].tolist()])]
        yield "destroyed", self._rows("destroyed", [(id,) for id in destroyed.tolist()])
        attached = [(a.id, a.parent) for a in actors if a.attached and a.id not in self._late]
        yield "parented", self._rows("parented", attached)
        doors = [(id, door, 1) for id, open in state.doors.items() if id not in new for door in sorted(open)]
        yield "doors", self._rows("doors", doors)
        yield "light_states", self._latest("light_states", frame, new)
        yield "scene_lights", _without(state.scene_lights, set(array(frame["scene_lights"])["id"].tolist()))
        if state.weather is not None and not len(frame["weather"]):
            yield "weather", np.atleast_1d(state.weather)
        for name, properties in self._properties.items():
            own = new | {int(record["id"]) if isinstance(record, np.void) else record.id for record in frame[name]}
            kept = [record for id, record in properties.items() if id not in own]
            if name == "physics":
                yield name, _alike(kept, frame["physics"])
            elif kept:
                yield name, np.concatenate(kept)

    def _late_parents(self, frame: Frame) -> dict[int, int]:
        """Return the parents by actor that are recorded after the spawn, in the frames up to a frame."""
        actors, new = self._state.actors, _spawned(frame)
        late = {actor.id: actor.parent for actor in actors.values() if actor.parent is not None and not actor.attached}
        late.update((id, parent) for id, parent in array(frame["parented"]).tolist() if id in actors)
        return {id: parent for id, parent in late.items() if id not in new}

    def _rows(self, name: str, rows: list[Any]) -> Records:
        return self._table.named(name).records(rows)

    def _latest(self, name: str, frame: Frame, new: set[int]) -> NDArray[np.void]:
        """Return the latest records of a type that a frame does not contain; most frames contain all."""
        own = set(array(frame[name])["id"].tolist())
        if own.issuperset(set(self._state.lasting(name).tolist()) - new):
            return np.empty(0, self._table.named(name).dtype)
        self._cursor.go_to(frame)
        return _without(self._cursor.state.latest[name].records, own)


def _spawned(frame: Frame) -> set[int]:
    return {spawn.id for spawn in frame["spawned"]}


def _moved(spawn: Spawn, pose: np.void | None) -> Spawn:
    """Return a spawn with the present pose of its actor."""
    return spawn if pose is None else replace(spawn, **{name: pose[name].item() for name in _POSE})


def _without(records: NDArray[np.void], ids: Collection[int]) -> NDArray[np.void]:
    return records[~np.isin(records["id"], list(ids))]


def _without_parents(packet: Packet, ids: Collection[int]) -> Packet:
    """Return a packet without the parents of some actors."""
    if not ids or packet.type is None or packet.type.name != "parented":
        return packet
    return Packet(packet.id, packet.type, records=_without(array(packet.records), ids))


def _alike(kept: list[Physics], own: list[Physics]) -> list[Physics]:
    """Return the physics whose wheels have the layout of the last ones, which all records of a packet share."""
    wheels = [physics.wheels.dtype for physics in (*kept, *own) if len(physics.wheels)]
    return [physics for physics in kept if not len(physics.wheels) or physics.wheels.dtype == wheels[-1]]


def _insert(packets: list[Packet], type: RecordType, records: Records) -> None:
    """Insert records into the packet of their type, or as a new packet in CARLA's order."""
    if not len(records):
        return
    rank = _RANKS[type.id]
    index = next((i for i, packet in enumerate(packets) if _RANKS.get(packet.id, -1) >= rank), len(packets))
    if index < len(packets) and packets[index].id == type.id:
        own = packets.pop(index).records
        records = np.concatenate((array(records), own)) if isinstance(own, np.ndarray) else [*records, *own]
    parts = [records[start : start + MAX_COUNT] for start in range(0, len(records), MAX_COUNT)]
    packets[index:index] = [Packet(type.id, type, records=part) for part in parts]
