"""Actors as models with lamps in the world, and as points on the map: they appear, move, lie down and disappear."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.errors import RecapWarning
from carla_recap.model.blueprints import box_of
from carla_recap.model.lives import ROAD_USERS
from carla_recap.replay import Destroyed, Spawned, quaternions, right_handed
from carla_recap.replay.pose import LOCATION
from carla_recap.scene import style
from carla_recap.scene.materials import LAMPS, MATERIALS, Material
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.followed import CameraAxes
from carla_recap.show.rerun.meshes import drawn, lamps_of, model_mesh, unlit
from carla_recap.show.rerun.stream import PoseBuffer, screen_radii
from carla_recap.show.rerun.surroundings import CorridorWriter

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.scene.appearance import Look
    from carla_recap.scene.description import LookColumns, SceneDescription
    from carla_recap.scene.materials import Color
    from carla_recap.scene.mesh import Mesh
    from carla_recap.show.rerun.stream import PoseBlock, Stream, TimeColumns, TimePoint
    from carla_recap.util.arrays import Ids

MOST_BOXES: Final = 5_000
"""The number of actors in the world at a time; the viewer is too slow to draw more. All are on the map."""

MOST_MODELS: Final = 1_000
"""The number of actors at a time that are drawn as models; others are boxes, which need less memory."""

_RADIUS: Final = 3.0  # points of the screen; of an actor on the map
_MARGIN: Final = 15.0  # m
_EDGE: Final = (45, 48, 56)
_NAME: Final = (240, 242, 246)
_BEHIND: Final = 0.8  # m; of names behind actors

_WITH_LAMPS: Final = ("vehicle", "traffic_light")


class ActorWriter:
    """Writes all actors; of those that the camera follows, the names are always shown.

    Vehicles and walkers among `cameras` get the axes of a camera. `models` are the present actors that are drawn as models.
    """

    def __init__(self, stream: Stream, followed: int | None, *, roads: bool, cameras: Iterable[int]) -> None:
        self._stream = stream
        self._followed = followed
        self._roads = roads
        self._cameras = {id: CameraAxes(stream, entities.camera(id)) for id in cameras if id != followed}
        self._present: set[int] = set()
        self._away: set[int] = set()  # those with poses that are not to be seen in the latest scene
        self.models: set[int] = set()
        self._lamps = LampWriter(stream)
        self._named: int | None = None  # the actor whose name has to be shown from the next scene on
        self._drawn: dict[int, Look | None] = {}  # the looks of the present actors that are in the world
        self._looks: LookColumns | None = None  # of the latest scene
        self._placed: set[int] = set()  # those, and the ones that were so since the last block
        self._riding: set[int] = set()  # the present ones that are placed on a parent, as long as they have no poses
        self._left_out: float | None = None  # the first moment at which an actor was not in the world, in elapsed seconds
        self._extent = np.array((np.inf, np.inf, -np.inf, -np.inf))  # of the map, whose axes are CARLA's
        self._colors: dict[int, int] = {}  # of the actors on the map, and of those removed since the last block
        self._corridors = None if roads else CorridorWriter(stream)
        self._vehicles: set[int] = set()  # those that are present, or were since the last block
        self._poses = PoseBuffer()
        self._ids: Ids | None = None
        stream.log_static(entities.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        stream.log_static(entities.MAP_ACTORS, rr.Points2D.from_fields(radii=screen_radii(_RADIUS)))

    @property
    def extent(self) -> NDArray[np.float64] | None:
        """The least x and y and the greatest x and y of the actors on the map so far, in m, in the map's axes."""
        return self._extent if np.isfinite(self._extent).all() else None

    def follow(self, id: int) -> None:
        """Show the name of another actor from now on."""
        self._followed = self._named = id

    def write(self, description: SceneDescription, times: TimeColumns) -> None:
        """Write scenes."""
        batch, spawned = description.batch, []
        away = set(batch.ids[~description.recorded_shown[0]].tolist())
        for event in batch.events:
            if isinstance(event, Spawned):
                if event.actor.id in away:
                    self._erase(event.actor.id, times.point(0))
                else:
                    self._draw(event.actor, description, times.point(0))
                spawned.append(event.actor.id)
            elif isinstance(event, Destroyed):
                self._erase(event.id, times.point(0))
        redrawn = set() if description.actors is self._looks else self._redraw(description, times.point(0))
        if batch.ids is not self._ids:
            self._ids = batch.ids
            for id in set(batch.ids.tolist()) - self._present - self._away - away:
                self._draw(description.lives[id], description, times.point(0))
            for id in self._riding.intersection(batch.ids.tolist()):
                self._riding.remove(id)
                in_world = rr.Transform3D.from_fields(parent_frame=f"tf#{entities.ACTORS}")
                self._stream.log(entities.actor(id), times.point(0), in_world)
        named = None if self._named is None else batch.actors.get(self._named)
        if named is not None:
            self._stream.log(entities.actor(named.id), times.point(0), _name(named, description.actors.look_of(named.id)))
            self._named = None
        again = self._hide(description, times)
        self._lay(description, times, [*again, *((0, id) for id in redrawn)])
        self._poses.add(description, times, [*spawned, *redrawn])
        if self._poses.is_full:
            self.flush()

    def flush(self) -> None:
        """Write the poses that are held back."""
        block = self._poses.take()
        if block is not None:
            block.write(self._stream, self._placed)
            points = block.write_points(self._stream, entities.MAP_ACTORS, self._colors, self._colors)
            if len(points):
                low, high = np.split(self._extent, 2)
                self._extent = np.concatenate((np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))))
            if self._corridors is not None:
                self._corridors.add(block, np.isin(block.ids, list(self._vehicles)))
            self._write_cameras(block)
        self._colors = {id: color for id, color in self._colors.items() if id in self._present}
        self._vehicles &= self._present
        self._placed = set(self._drawn)

    def close(self) -> None:
        """Write what is held back, and if the map has no roads, an edge around it, so that it keeps its scale."""
        self.flush()
        if self._left_out is not None:
            text = f"from {self._left_out:g} s on, actors are only on the map: there are more than {MOST_BOXES} at a time"
            warnings.warn(text, RecapWarning, stacklevel=2)
        if self._corridors is not None:
            self._corridors.close()
        if not self._roads and np.isfinite(self._extent).all():
            left, top, right, bottom = self._extent + np.array((-_MARGIN, -_MARGIN, _MARGIN, _MARGIN))
            corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
            self._stream.log_static(entities.MAP_EDGE, rr.LineStrips2D([corners], colors=[_EDGE], radii=screen_radii(0.5)))

    def _draw(self, actor: ActorLife, description: SceneDescription, time: TimePoint) -> None:
        path = entities.actor(actor.id)
        if actor.id in self._drawn:
            del self._drawn[actor.id]
            self._stream.clear(path, time)
        self._present.add(actor.id)
        self._colors.pop(actor.id, None)
        self.models.discard(actor.id)
        self._riding.discard(actor.id)
        if actor.kind == "vehicle":
            self._vehicles.add(actor.id)
        if actor.kind in ROAD_USERS:
            red, green, blue = style.color_of(actor)
            self._colors[actor.id] = red << 24 | green << 16 | blue << 8 | 255
        if len(self._drawn) >= MOST_BOXES and actor.id != self._followed:
            self._left_out = time.elapsed / 1e9 if self._left_out is None else self._left_out
            return
        self._drawn[actor.id] = look = description.actors.look_of(actor.id)
        self._placed.add(actor.id)
        archetypes: list[rr.AsComponents] = [rr.AnyValues(name=style.label_of(actor))]
        if look is not None and len(self.models) < MOST_MODELS:
            self.models.add(actor.id)
            mesh = model_mesh(look)
            archetypes.append(drawn(look, mesh, with_shadow=actor.kind == "vehicle"))
            if actor.kind in _WITH_LAMPS:
                self._lamps.add(actor.id, mesh)
        elif look is not None:
            archetypes.append(_box(look))
        if actor.is_hero or actor.id == self._followed:
            archetypes.append(_name(actor, look))
        if description.batch.index_of(actor.id) is None:
            archetypes.append(_location(actor))
            if actor.attached:
                self._riding.add(actor.id)
        self._stream.log(path, time, *archetypes)

    def _erase(self, id: int, time: TimePoint) -> None:
        if id in self._present:
            self._present.remove(id)
            self._lamps.remove(id)
            self.models.discard(id)
            if id in self._drawn:
                del self._drawn[id]
                self._stream.clear(entities.actor(id), time)

    def _redraw(self, description: SceneDescription, time: TimePoint) -> set[int]:
        """Draw the actors again whose looks have changed, as by a box recorded after the spawn; return their ids."""
        self._looks = description.actors
        looks = dict(zip(self._looks.ids.tolist(), self._looks.looks, strict=True))
        changed = {id for id, look in self._drawn.items() if looks.get(id, look) != look}
        for id in changed:
            self._lamps.remove(id)
            self._draw(description.lives[id], description, time)
        return changed

    def _hide(self, description: SceneDescription, times: TimeColumns) -> list[tuple[int, int]]:
        """Erase actors from when on they are not to be seen, and draw them again when they are; return those rows and ids.

        Lamps are written in between, as they are those of what is drawn.
        """
        batch, again, away, start = description.batch, [], ~description.recorded_shown, 0
        before = np.isin(batch.ids, list(self._away))
        changed = away != np.concatenate((before[None], away[:-1]))
        for row, column in zip(*(index.tolist() for index in np.nonzero(changed)), strict=True):
            id = int(batch.ids[column])
            self._lamps.write(description, times, start, row)
            start = row
            if away[row, column]:
                self._erase(id, times.point(row))
            elif id not in self._present:
                self._draw(description.lives[id], description, times.point(row))
                again.append((row, id))
        self._lamps.write(description, times, start, len(batch))
        self._away = set(batch.ids[away[-1]].tolist())
        return again

    def _lay(self, description: SceneDescription, times: TimeColumns, again: Iterable[tuple[int, int]]) -> None:
        """Lay down the models of walkers, also of those drawn again at some rows; their transforms stay those recorded."""
        lying = [(row, id, description.fallen_at(row)[id]) for row, id in again if id in description.fallen_at(row)]
        for row, id, fall in (*lying, *description.falls):
            look = description.actors.look_of(id)
            if look is not None:
                matrix = np.eye(3) if fall is None else fall.matrix
                offset = np.zeros(3) if fall is None else fall.offset - matrix @ look.center
                self._stream.log(
                    entities.actor(id), times.point(row), rr.InstancePoses3D(translations=[offset], mat3x3=[matrix])
                )

    def _write_cameras(self, block: PoseBlock) -> None:
        times = block.times.take(slice(1, None))
        for index, id in enumerate(block.ids.tolist()):
            if id in self._cameras and id in self._colors:
                poses = np.where(block.present[1:, index, None], block.poses[1:, index], np.nan)
                self._cameras[id].write(times, poses)


def _location(actor: ActorLife) -> rr.Transform3D:
    """Return the pose of an actor without recorded poses: that of its spawn, or fixed to its parent."""
    pose = right_handed(actor.spawn_pose)
    upon = entities.actor(actor.parent) if actor.attached and actor.parent is not None else None
    return rr.Transform3D(
        translation=pose[LOCATION],
        quaternion=rr.Quaternion(xyzw=quaternions(pose)),
        parent_frame=f"tf#{upon}" if upon else None,
    )


def _box(look: Look) -> rr.Boxes3D:
    """Return the box of an actor."""
    return rr.Boxes3D(centers=[look.center], half_sizes=[look.half_extents], colors=[look.color], fill_mode="solid")


def _name(actor: ActorLife, look: Look | None) -> rr.Points3D:
    """Return the name of an actor, behind it on the ground, where it hides nothing that is ahead."""
    box = box_of(actor)
    half, center = (box.extent_x, box.extent_z), (box.x, box.z)
    if look is not None:
        half, center = (look.half_extents[0], look.half_extents[2]), (look.center[0], look.center[2])
    location = (center[0] - half[0] - _BEHIND, 0.0, center[1] - half[1])
    return rr.Points3D(
        [location],
        colors=[style.HERO if actor.is_hero else _NAME],
        radii=[0],
        labels=[style.label_of(actor)],
        show_labels=True,
    )


def _factor_columns(colors: Sequence[Color]) -> Iterable[rr.ComponentColumn]:
    return rr.Mesh3D.columns(albedo_factor=np.array(colors, np.uint8))


class LampWriter:
    """Writes the lamps of actors whenever they change: an entity for each kind of lamp that is ever lit."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._meshes: dict[int, Mesh] = {}
        self._lit: dict[int, int] = {}  # the lamps of each actor in the latest scene, as in `SceneDescription.lamps`
        self._drawn: dict[int, dict[Material, str | None]] = {}  # the entities of the lamps of each actor

    def add(self, id: int, mesh: Mesh) -> None:
        """Add an actor, of which nothing is lit."""
        self._meshes[id], self._lit[id], self._drawn[id] = mesh, 0, {}

    def remove(self, id: int) -> None:
        """Forget an actor."""
        for known in (self._meshes, self._lit, self._drawn):
            known.pop(id, None)

    def write(self, description: SceneDescription, times: TimeColumns, start: int, stop: int) -> None:
        """Write some of the scenes."""
        if start == stop:
            return
        lamps, ids = description.lamps[start:stop], description.ids
        before = np.array([self._lit.get(id, 0) for id in ids.tolist()], np.uint64)
        rows, columns = np.nonzero(lamps != np.concatenate((before[None], lamps[:-1])))
        for row, id, lit in zip(rows.tolist(), ids[columns].tolist(), lamps[rows, columns].tolist(), strict=True):
            if id in self._meshes:
                self._change(id, lit, times.point(start + row))

    def _change(self, id: int, lamps: int, time: TimePoint) -> None:
        """Note the lit lamps of an actor, given as bits `1 << material`."""
        changed, self._lit[id] = self._lit[id] ^ lamps, lamps
        for material in LAMPS:
            if changed >> material & 1 and (path := self._drawn_lamps(id, material, time)) is not None:
                finish = MATERIALS[material]
                color = finish.glow if lamps >> material & 1 else None
                self._stream.hold(path, _factor_columns, time, color or finish.color)

    def _drawn_lamps(self, id: int, material: Material, time: TimePoint) -> str | None:
        """Return the entity of the lamps of an actor, which are drawn on first use; None if it has none."""
        drawn = self._drawn[id]
        if material not in drawn:
            mesh = lamps_of(self._meshes[id], material)
            drawn[material] = None if mesh is None else entities.lamps(id, material.name)
            if mesh is not None:
                self._stream.log(entities.lamps(id, material.name), time, unlit(mesh))
        return drawn[material]
