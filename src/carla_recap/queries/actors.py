"""Who was there: every actor, when it came and went, and what is known of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

from carla_recap.model.records import CM, ActorKind, Spawn
from carla_recap.queries.answer import Answer
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    import numpy as np
    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader


@dataclass(frozen=True, slots=True)
class BoundingBox:
    """The box of an actor, in its own axes, right-handed (x forward, y left, z up): centre and half extents in m."""

    x: float
    y: float
    z: float
    extent_x: float
    extent_y: float
    extent_z: float


@dataclass(slots=True)
class Actor:
    """An actor of a recording.

    Attributes:
        id: The actor id; where a recording gives it out again, each actor that had it is listed.
        type_id: The blueprint, such as vehicle.tesla.model3.
        kind: What it is: vehicle, walker, traffic_light, traffic_sign, sensor, other; or CARLA's number, if unknown.
        role_name: The attribute role_name, "" without one.
        spawned_at: Elapsed seconds at which it appeared.
        destroyed_at: Elapsed seconds at which it disappeared; None: it stayed.
        parent: The actor that it is attached to, if any.
        attributes: All attributes, as text.
        bounding_box: Its box, where a sane one is recorded.
    """

    id: int
    type_id: str
    kind: str
    role_name: str
    spawned_at: float
    destroyed_at: float | None = None
    parent: int | None = None
    attributes: dict[str, str] = field(default_factory=dict)
    bounding_box: BoundingBox | None = None

    @property
    def is_hero(self) -> bool:
        """Whether its role_name is hero."""
        return self.role_name == "hero"


class Actors(Answer[Actor]):
    """The actors of a recording, in order of appearance."""

    row_type = Actor
    row_units: ClassVar = {"spawned_at": "s", "destroyed_at": "s"}


def actors(source: Reader) -> Actors:
    """The actors of a recording; on MCAP, read from the events alone.

    Raises:
        FormatError: The file contradicts its format.
    """
    found: list[Actor] = []
    present: dict[int, Actor] = {}
    for frame in source.frames(tuple(_EVENTS), sparse=True):
        for packet in frame.packets:
            assert packet.type is not None
            found += _EVENTS[packet.type.name](present, packet.records, frame.elapsed)
    return Actors(found, source, compat=False)


def _spawn(present: dict[int, Actor], spawns: Iterable[Spawn], elapsed: float) -> list[Actor]:
    new = []
    for spawn in spawns:
        attributes = {readable(item.key): readable(item.value) for item in spawn.attributes}
        actor = Actor(
            spawn.id,
            readable(spawn.type_id),
            _kind(spawn.kind),
            attributes.get("role_name", ""),
            elapsed,
            attributes=attributes,
        )
        present[spawn.id] = actor
        new.append(actor)
    return new


def _kind(kind: int) -> str:
    try:
        return ActorKind(kind).name.lower()
    except ValueError:
        return str(kind)


def _destroy(present: dict[int, Actor], records: NDArray[np.void], elapsed: float) -> tuple[()]:
    for id in records["id"].tolist():
        if id in present:
            present.pop(id).destroyed_at = elapsed
    return ()


def _parent(present: dict[int, Actor], records: NDArray[np.void], elapsed: float) -> tuple[()]:
    for id, parent in records.tolist():
        if id in present:
            present[id].parent = parent
    return ()


def _box(present: dict[int, Actor], records: NDArray[np.void], elapsed: float) -> tuple[()]:
    for id, *sizes in records.tolist():
        if id in present and all(map(math.isfinite, sizes)) and min(sizes[3:]) > 0:
            x, y, z, *extent = (size * CM for size in sizes)
            present[id].bounding_box = BoundingBox(x, -y, z, *extent)
    return ()


_EVENTS: Final[dict[str, Callable[[dict[int, Actor], Any, float], Iterable[Actor]]]] = {
    "spawned": _spawn,
    "destroyed": _destroy,
    "parented": _parent,
    "bounding_boxes": _box,
}
