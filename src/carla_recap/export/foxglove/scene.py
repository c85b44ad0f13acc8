"""The actors of a scene as two topics: those that have moved, and those that have not."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export import style
from carla_recap.export.foxglove.entities import CUBES, SPHERES, WORLD, Heads, color, deletions, head
from carla_recap.export.foxglove.schemas import CylinderPrimitive, KeyValuePair, SceneEntity
from carla_recap.model.records import ActorKind, Spawn
from carla_recap.replay import Present, quaternions, right_handed
from carla_recap.replay.pose import LOCATION, change, rotations
from carla_recap.replay.rows import NO_IDS
from carla_recap.v1.light_states_pb2 import TRAFFIC_LIGHT_COLOR_UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.replay import Scene
    from carla_recap.replay.rows import Ids

    Floats = NDArray[np.float64]

MOVED: Final = "/scene"
STILL: Final = "/scene/still"

_STIR: Final = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # cm and degrees; whoever is farther from its first pose has moved
_FAINT: Final = 0.35  # opacity of a box that only stands for something; Foxglove's cubes have no outlines
_FAR: Final = 1e9  # cm and degrees; what is beyond is no place


@dataclass(eq=False, slots=True)
class _Figure:
    """An actor as it is shown.

    Attributes:
        actor: Who it is.
        state: What it shows, if it is a traffic light.
        first: Its first pose; not a number before.
        moved: Whether it has moved since.
        head: Its entity, but for the pose.
        center: The middle of its box, or of its lamp, in its own axes, in m.
    """

    actor: Present
    state: int
    first: Floats = field(default_factory=lambda: np.full(6, np.nan))
    moved: bool = False
    head: bytes = b""
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def draw(self) -> None:
        """Make what depends on the actor and its state."""
        actor = self.actor
        told = {"actor": style.label_of(actor), "type_id": actor.type_id, "role_name": actor.role_name}
        if actor.kind == ActorKind.TRAFFIC_LIGHT:
            state, shade = style.light(self.state)
            self.center = (0.0, 0.0, style.LAMP_UP)
            self.head = head(
                _start(actor, told | {"state": state}, _pole(actor)),
                SPHERES,
                (style.LAMP, style.LAMP, style.LAMP),
                color(shade),
            )
        else:
            box = style.box_of(actor)
            self.center = (box.x, box.y, box.z)
            size = (2 * box.extent_x, 2 * box.extent_y, 2 * box.extent_z)
            opacity = _FAINT if style.is_outlined(actor) else 1.0
            self.head = head(_start(actor, told), CUBES, size, color(style.color_of(actor), opacity))


def _start(actor: Present, told: Mapping[str, str], *fixed: CylinderPrimitive) -> SceneEntity:
    """What of an entity does not move, and what is told when it is selected."""
    metadata = [KeyValuePair(key=key, value=value) for key, value in told.items() if value]
    return SceneEntity(frame_id=WORLD, id=entity(actor.id), metadata=metadata, cylinders=fixed)


def _pole(actor: Present) -> CylinderPrimitive:
    """The pole of a traffic light, which never moves."""
    x, y, z = right_handed(actor.spawn_pose)[LOCATION].tolist()
    pole = CylinderPrimitive(bottom_scale=1.0, top_scale=1.0, color=color(style.POLE))
    pole.pose.position.x, pole.pose.position.y, pole.pose.position.z = x, y, z + style.LAMP_UP / 2
    pole.pose.orientation.w = 1.0
    pole.size.x = pole.size.y = style.POLE_WIDTH
    pole.size.z = style.LAMP_UP
    return pole


@dataclass(frozen=True, eq=False, slots=True)
class Shapes:
    """What of a message is the same until actors come, go or change: their heads, and the middle of each, (actors, 3, 1)."""

    heads: Heads
    centers: Floats


@dataclass(frozen=True, eq=False, slots=True)
class Drawing:
    """A message that is still to be serialized.

    Attributes:
        shapes: The actors; the same object in messages that show the same.
        poses: Where they are, (actors, 6).
        deletions: The part of the message that says who is gone.
        time: Nanoseconds since 1970.
    """

    shapes: Shapes
    poses: Floats
    deletions: bytes
    time: int


def serialized(drawings: Sequence[Drawing]) -> Iterator[bytes]:
    """Yield the serialized message of each drawing; those in a row that show the same actors are made together."""
    for shapes, alike in groupby(drawings, key=lambda drawing: drawing.shapes):
        some = list(alike)
        poses = right_handed(np.stack([drawing.poses for drawing in some]))
        positions = poses[..., LOCATION] + (rotations(poses) @ shapes.centers)[..., 0]
        updates = shapes.heads.updates(positions, quaternions(poses), [drawing.time for drawing in some])
        yield from (drawing.deletions + update for drawing, update in zip(some, updates, strict=True))


def entity(id: int) -> str:
    """The name of an actor's entity."""
    return f"actor {id}"


class Actors:
    """Says what changes on the two topics from scene to scene. Sensors, which have no body, are left out."""

    def __init__(self) -> None:
        self._roster: list[Present] = []
        self._ids: Ids | None = None
        self._figures: dict[int, _Figure] = {}
        self._cast: list[_Figure] = []  # those of this moment
        self._cast_ids = NO_IDS
        self._recorded: NDArray[np.intp] = np.zeros(0, np.intp)  # who of them has a pose of its own in a scene,
        self._places: NDArray[np.intp] = np.zeros(0, np.intp)  # and which
        self._carried: list[tuple[int, int]] = []  # who goes along with a parent: its place in the cast, and its id
        self._poses: Floats = np.zeros((0, 6))
        self._firsts: Floats = np.zeros((0, 6))
        self._moved: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._light_states: bytes | None = None  # the latest ids and states
        self._on_moved = _Shown()
        self._on_still = _Shown()
        self._shapes: dict[str, tuple[bytes, Shapes]] = {}  # of the latest message of each topic, and of which rows

    def messages(self, scene: Scene, time: int) -> Iterator[tuple[str, Drawing]]:
        """Topics and messages that are still to be serialized.

        Args:
            scene: What is to be shown.
            time: The same moment in nanoseconds since 1970.
        """
        changed = self._take_roster(scene) | self._take_lights(scene)
        if changed:
            self._shapes.clear()
        self._take_poses(scene)
        there = np.asarray((np.abs(self._poses) < _FAR).all(axis=1))  # and a number
        changed |= self._take_moves(there)
        rows = np.flatnonzero(there & self._moved)
        gone = self._on_moved.take(self._cast_ids[rows])
        if len(rows) or gone or scene.fresh:
            yield MOVED, self._drawing(MOVED, rows, gone or (), time)
        rows = np.flatnonzero(there & ~self._moved)
        gone = self._on_still.take(self._cast_ids[rows])
        if changed or gone is not None or scene.fresh:
            yield STILL, self._drawing(STILL, rows, gone or (), time)

    def _take_roster(self, scene: Scene) -> bool:
        roster = list(scene.actors.values())
        if roster == self._roster and scene.ids is self._ids:
            return False
        self._roster, self._ids = roster, scene.ids
        strangers = set(scene.ids.tolist()).difference(scene.actors)
        figures: dict[int, _Figure] = {}
        for actor in (*roster, *(Present(Spawn(id), scene.time) for id in sorted(strangers))):
            figure = self._figures.get(actor.id)
            if figure is None or figure.actor.spawn != actor.spawn:
                figure = _Figure(actor, TRAFFIC_LIGHT_COLOR_UNKNOWN)
            if not figure.head or figure.actor != actor:
                figure.actor = actor
                figure.draw()
            figures[actor.id] = figure
        self._figures = figures
        self._cast = [figure for figure in figures.values() if _has_body(figure.actor)]
        self._cast_ids = np.array([figure.actor.id for figure in self._cast], np.uint32)
        self._light_states = None
        self._place(scene)
        return True

    def _place(self, scene: Scene) -> None:
        """Find out how each actor of the cast gets its pose."""
        places = [scene.index_of(figure.actor.id) for figure in self._cast]
        self._recorded = np.array([row for row, place in enumerate(places) if place is not None], np.intp)
        self._places = np.array([place for place in places if place is not None], np.intp)
        self._poses = np.full((len(self._cast), 6), np.nan)
        self._firsts = np.array([figure.first for figure in self._cast]).reshape(-1, 6)
        self._moved = np.array([figure.moved for figure in self._cast], np.bool_)
        self._carried = []
        for row, figure in enumerate(self._cast):
            if places[row] is None:
                pose = scene.pose_of(figure.actor.id)
                self._poses[row] = np.nan if pose is None else pose
                if figure.actor.attached:
                    self._carried.append((row, figure.actor.id))

    def _take_poses(self, scene: Scene) -> None:
        self._poses[self._recorded] = scene.poses[self._places]
        for row, id in self._carried:
            pose = scene.pose_of(id)
            self._poses[row] = np.nan if pose is None else pose

    def _take_lights(self, scene: Scene) -> bool:
        states = scene.light_states
        shown = states["id"].tobytes() + states["state"].tobytes()
        if shown == self._light_states:
            return False
        self._light_states = shown
        changed = False
        for id, state in zip(states["id"].tolist(), states["state"].tolist(), strict=True):
            figure = self._figures.get(id)
            if figure is not None and figure.state != state:
                figure.state = state
                figure.draw()
                changed = True
        return changed

    def _take_moves(self, there: NDArray[np.bool_]) -> bool:
        """Note who moves for the first time; says whether anybody does."""
        for row in np.flatnonzero(there & np.isnan(self._firsts[:, 0])).tolist():
            self._firsts[row] = self._cast[row].first = self._poses[row].copy()
        candidates = np.flatnonzero(there & ~self._moved)
        with np.errstate(invalid="ignore", over="ignore"):
            ways = change(self._firsts[candidates], self._poses[candidates])
        stirred = candidates[(np.abs(ways) > _STIR).any(axis=1)].tolist()
        for row in stirred:
            self._cast[row].moved = self._moved[row] = True
        return bool(stirred)

    def _drawing(self, topic: str, rows: NDArray[np.intp], gone: Iterable[str], time: int) -> Drawing:
        key = rows.tobytes()
        before = self._shapes.get(topic)
        if before is None or before[0] != key:
            cast = [self._cast[row] for row in rows.tolist()]
            centers = np.array([figure.center for figure in cast]).reshape(-1, 3, 1)
            before = self._shapes[topic] = (key, Shapes(Heads(figure.head for figure in cast), centers))
        return Drawing(before[1], self._poses[rows], deletions(gone, time), time)


class _Shown:
    """The actors that a topic shows."""

    def __init__(self) -> None:
        self._ids: Ids = NO_IDS

    def take(self, ids: Ids) -> list[str] | None:
        """Take the next ones; gives the entities of those that are gone, None if all are the same."""
        before, self._ids = self._ids, ids
        return None if np.array_equal(before, ids) else [entity(id) for id in np.setdiff1d(before, ids).tolist()]


def _has_body(actor: Present) -> bool:
    return actor.kind != ActorKind.SENSOR and not actor.type_id.startswith("sensor.")
