"""What lasts: records that are written once and hold on, gathered so that a recording can begin anywhere."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.frame import Frame, Packet
from carla_recap.model.layout import MAX_COUNT
from carla_recap.model.records import FRAME_END, ORDER, Group
from carla_recap.replay.cursor import Cursor
from carla_recap.replay.rows import array, latest
from carla_recap.replay.state import ReplayState

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.layout import Records
    from carla_recap.model.records import Physics, RecordType, Spawn

_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_LATEST: Final = ("bounding_boxes", "trigger_volumes", "light_times", "physics")  # of each actor the latest one holds
_BEHIND: Final = {id: rank for rank, id in enumerate((*ORDER, FRAME_END))}


class InitialState:
    """What the frames before one have left behind: who is there, who has gone, what is known of them, weather, lamps, doors.

    The physics of UE5 builds, which are kept as bytes, and what CARLA tells anew in each frame are not among it.

    Args:
        source: The recording.
    """

    _next: Frame | None  # the first frame with events that is not taken in
    _read: int  # the index behind the latest one that is
    _late: dict[int, int]  # by actor, the parents that `go_on` is to tell

    def __init__(self, source: Reader) -> None:
        self.source = source
        self._table = source.header.table
        self._rewind()

    def begin(self, frame: Frame) -> Frame:
        """A frame with all that lasts told in it, too: first what lasts, then its own, packet by packet.

        Of an actor whose parent was told in its spawn's frame, the spawn has its pose on the parent; of another one, the
        pose in the world. So the parent of such another one must not be told before the next frame; see `go_on`.

        To ask for frames in their order is fastest.

        Raises:
            FormatError: The file contradicts its format.
        """
        if self._read > frame.index:
            self._rewind()
        while self._next is not None and self._next.index < frame.index:
            self._apply(self._next)
            self._next = next(self._stream, None)
        self._late = self._late_parents(frame)
        begun = [_without_parents(packet, self._late) for packet in frame.packets]
        for name, records in self._records(frame):
            _insert(begun, self._table.named(name), records)
        return Frame(frame.index, frame.id, frame.elapsed, frame.duration, begun)

    def go_on(self, frame: Frame) -> Frame:
        """A frame behind the one that was begun with, in order; the next one tells the parents that had to wait."""
        late, self._late = self._late, {}
        if not late:
            return frame
        come_or_gone = _spawned(frame).union(array(frame["destroyed"])["id"].tolist())
        packets = list(frame.packets)
        rows = [(id, parent) for id, parent in late.items() if id not in come_or_gone]
        _insert(packets, self._table.named("parented"), self._rows("parented", rows))
        return Frame(frame.index, frame.id, frame.elapsed, frame.duration, packets)

    def _rewind(self) -> None:
        types = [type.name for type in self._table if type.group is Group.EVENTS and type.name != "collisions"]
        self._stream = self.source.frames(types, sparse=True)
        self._next = next(self._stream, None)
        self._read = 0
        self._late = {}
        self._world = self._new_world()
        self._latest: dict[str, dict[int, Any]] = defaultdict(dict)

    def _apply(self, frame: Frame) -> None:
        self._read = frame.index + 1
        self._world.apply(frame)
        for packet in frame.packets:
            if packet.type is not None:
                self._note(packet.type.name, packet.records)

    def _new_world(self) -> ReplayState:
        return ReplayState(self._table, ignore_hero=False, ignore_spectator=False)

    def _note(self, name: str, records: Records) -> None:
        if name in ("spawned", "destroyed"):
            ids = [spawn.id for spawn in records] if name == "spawned" else array(records)["id"].tolist()
            for held in self._latest.values():
                for id in ids:
                    held.pop(id, None)
        elif name in _LATEST:
            for place, record in enumerate(records):
                if isinstance(records, np.ndarray):
                    self._latest[name][int(record["id"])] = records[place : place + 1].copy()
                else:
                    self._latest[name][record.id] = record

    def _records(self, frame: Frame) -> Iterator[tuple[str, Records]]:
        """By type, what lasts and is not told by a frame itself."""
        world, new = self._world, _spawned(frame)
        actors = [actor for actor in world.actors.values() if actor.id not in new]
        poses = {pose["id"].item(): pose for pose in latest(array(frame["transforms"]))}
        yield "spawned", [a.spawn if a.attached else _placed(a.spawn, poses.get(a.id)) for a in actors]
        gone = world.hidden[~np.isin(world.hidden, [*new, *array(frame["destroyed"])["id"].tolist()])]
        yield "destroyed", self._rows("destroyed", [(id,) for id in gone.tolist()])
        attached = [(a.id, a.parent) for a in actors if a.attached and a.id not in self._late]
        yield "parented", self._rows("parented", attached)
        doors = [(id, door, 1) for id, open in world.doors.items() if id not in new for door in sorted(open)]
        yield "doors", self._rows("doors", doors)
        yield "light_states", self._light_states(frame, new)
        yield "scene_lights", _without(world.scene_lights, set(array(frame["scene_lights"])["id"].tolist()))
        if world.weather is not None and not len(frame["weather"]):
            yield "weather", np.atleast_1d(world.weather)
        for name, held in self._latest.items():
            told = new | {int(record["id"]) if isinstance(record, np.void) else record.id for record in frame[name]}
            kept = [record for id, record in held.items() if id not in told]
            if name == "physics":
                yield name, _alike(kept, frame["physics"])
            elif kept:
                yield name, np.concatenate(kept)

    def _late_parents(self, frame: Frame) -> dict[int, int]:
        """By actor, the parents that are told in a later frame than the spawn, until a frame and in it."""
        actors, new = self._world.actors, _spawned(frame)
        late = {actor.id: actor.parent for actor in actors.values() if actor.parent is not None and not actor.attached}
        late.update((id, parent) for id, parent in array(frame["parented"]).tolist() if id in actors)
        return {id: parent for id, parent in late.items() if id not in new}

    def _rows(self, name: str, rows: list[Any]) -> Records:
        return self._table.named(name).records(rows)

    def _light_states(self, frame: Frame, new: set[int]) -> NDArray[np.void]:
        """The latest states of the traffic lights that a frame does not tell of; most recordings have all in each."""
        told = set(array(frame["light_states"])["id"].tolist())
        if told.issuperset(set(self._world.lights.tolist()) - new):
            return np.empty(0, self._table.named("light_states").dtype)
        cursor = Cursor(self.source, self._new_world)
        cursor.seek(frame.elapsed)
        return _without(cursor.state.light_states, told)


def _spawned(frame: Frame) -> set[int]:
    return {spawn.id for spawn in frame["spawned"]}


def _placed(spawn: Spawn, pose: np.void | None) -> Spawn:
    """A spawn where its actor is by now."""
    return spawn if pose is None else replace(spawn, **{name: pose[name].item() for name in _POSE})


def _without(records: NDArray[np.void], ids: Collection[int]) -> NDArray[np.void]:
    return records[~np.isin(records["id"], list(ids))]


def _without_parents(packet: Packet, ids: Collection[int]) -> Packet:
    """A packet that tells no parents of some actors."""
    if not ids or packet.type is None or packet.type.name != "parented":
        return packet
    return Packet(packet.id, packet.type, records=_without(array(packet.records), ids))


def _alike(held: list[Physics], own: list[Physics]) -> list[Physics]:
    """Those whose wheels can stand in one packet with the others: a build writes all wheels alike."""
    wheels = [physics.wheels.dtype for physics in (*held, *own) if len(physics.wheels)]
    return [physics for physics in held if not len(physics.wheels) or physics.wheels.dtype == wheels[-1]]


def _insert(packets: list[Packet], type: RecordType, records: Records) -> None:
    """Put records before all that CARLA writes behind them, or into the packet that stands there."""
    if not len(records):
        return
    rank = _BEHIND[type.id]
    at = next((at for at, packet in enumerate(packets) if _BEHIND.get(packet.id, -1) >= rank), len(packets))
    if at < len(packets) and packets[at].id == type.id:
        own = packets.pop(at).records
        records = np.concatenate((array(records), own)) if isinstance(own, np.ndarray) else [*records, *own]
    parts = [records[start : start + MAX_COUNT] for start in range(0, len(records), MAX_COUNT)]
    packets[at:at] = [Packet(type.id, type, records=part) for part in parts]
