"""Actors as models in the world and as points on the map: they appear, move and disappear."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.errors import RecapWarning
from carla_recap.model.actors import ROAD_USERS, ActorLife
from carla_recap.model.blueprints import box_of
from carla_recap.model.records import CM, Spawn
from carla_recap.replay import Destroyed, Spawned, quaternions, right_handed
from carla_recap.replay.pose import LOCATION
from carla_recap.scene import style
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.corridors import CorridorWriter
from carla_recap.show.rerun.followed import CameraAxes
from carla_recap.show.rerun.lamps import LampWriter
from carla_recap.show.rerun.meshes import drawn, model_mesh
from carla_recap.show.rerun.poses import PoseBuffer
from carla_recap.show.rerun.stream import screen_radii

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.replay.selection import Ids
    from carla_recap.scene.appearance import Look
    from carla_recap.scene.description import SceneDescription
    from carla_recap.show.rerun.poses import PoseBlock
    from carla_recap.show.rerun.stream import Stream, TimeColumns, TimePoint

"""The kinds that are on the map and that a camera can follow."""

MOST_BOXES: Final = 5_000
"""The number of actors in the world, the first ones; the viewer is too slow to draw more. All are on the map."""

MOST_MODELS: Final = 1_000
"""The number of actors that are drawn as models, the first ones; others are boxes, which need less memory."""

_RADIUS: Final = 3.0  # points of the screen; of an actor on the map
_MARGIN: Final = 15.0  # m
_EDGE: Final = (45, 48, 56)
_NAME: Final = (240, 242, 246)
_BEHIND: Final = 0.8  # m; of names behind actors


class ActorWriter:
    """Writes all actors.

    Args:
        stream: The stream.
        followed: The actor that the camera follows: its name is always shown.
        roads: Whether the map has roads.
        cameras: Ids of other actors that get the axes of a camera, if they are vehicles or walkers.

    Attributes:
        looks: The looks of the present actors that are drawn as models, by id.
    """

    def __init__(self, stream: Stream, followed: int | None, *, roads: bool, cameras: Iterable[int]) -> None:
        self._stream = stream
        self._followed = followed
        self._roads = roads
        self._cameras = {id: CameraAxes(stream, paths.camera(id)) for id in cameras if id != followed}
        self._present: set[int] = set()
        self._away: set[int] = set()  # those of the latest scene that are not there
        self._models = 0
        self.looks: dict[int, Look] = {}
        self._lamps = LampWriter(stream)
        self._named: int | None = None  # the actor whose name has to be shown from the next scene on
        self._boxed: set[int] = set() if followed is None else {followed}  # actors that have had a box, or will have one
        self._left_out: set[int] = set()
        self._extent = np.array((np.inf, np.inf, -np.inf, -np.inf))  # of the map: least and greatest x and y
        self._colors: dict[int, int] = {}  # of the actors on the map, and of those removed since the last block
        self._corridors = None if roads else CorridorWriter(stream)
        self._vehicles: set[int] = set()  # all that have been present
        self._poses = PoseBuffer()
        self._ids: Ids | None = None
        stream.log_static(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        stream.log_static(paths.MAP_ACTORS, rr.Points2D.from_fields(radii=screen_radii(_RADIUS)))

    @property
    def extent(self) -> NDArray[np.float64] | None:
        """The least x and y and the greatest x and y of the actors on the map so far, in m, left-handed."""
        return self._extent if np.isfinite(self._extent).all() else None

    def follow(self, id: int) -> None:
        """Show the name of another actor from now on."""
        self._followed = self._named = id
        self._boxed.add(id)

    def write(self, description: SceneDescription, times: TimeColumns) -> None:
        """Write scenes."""
        batch, spawned = description.batch, []
        away = set(batch.ids[batch.away[0]].tolist())
        for event in batch.events:
            if isinstance(event, Spawned):
                if event.actor.id in away:
                    self._erase(event.actor.id, times.point(0))
                else:
                    self._draw(event.actor, description, times.point(0))
                spawned.append(event.actor.id)
            elif isinstance(event, Destroyed):
                self._erase(event.id, times.point(0))
        if away or self._away or batch.away.any():
            self._hide(description, times)
        if batch.ids is not self._ids:
            self._ids = batch.ids
            for id in set(batch.ids.tolist()) - self._present - away:
                self._draw(ActorLife.of(Spawn(id), float(batch.time[0])), description, times.point(0))
        named = None if self._named is None else batch.actors.get(self._named)
        if named is not None:
            self._stream.log(paths.actor(named.id), times.point(0), _name(named, description.actors.look_of(named.id)))
            self._named = None
        self._lamps.write(description, times)
        self._lay(description, times)
        self._poses.add(batch, times, spawned)
        if self._poses.is_full:
            self._write_poses()

    def flush(self) -> None:
        """Write what is held back."""
        self._lamps.flush()
        self._write_poses()

    def _write_poses(self) -> None:
        block = self._poses.take()
        if block is not None:
            block.write(self._stream, self._boxed)
            self._write_map(block)
            if self._corridors is not None:
                self._corridors.add(block, np.isin(block.ids, list(self._vehicles)))
            self._write_cameras(block)
        self._colors = {id: color for id, color in self._colors.items() if id in self._present}

    def close(self) -> None:
        """Write what is held back, and if the map has no roads, an edge around it, so that it keeps its scale.

        Warns:
            RecapWarning: There are too many actors for all of them to have boxes.
        """
        self.flush()
        if self._left_out:
            count = len(self._left_out)
            warnings.warn(
                f"{count} actors are only on the map: there are more than {MOST_BOXES}", RecapWarning, stacklevel=2
            )
        if self._corridors is not None:
            self._corridors.close()
        if not self._roads and np.isfinite(self._extent).all():
            left, top, right, bottom = self._extent + np.array((-_MARGIN, -_MARGIN, _MARGIN, _MARGIN))
            corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
            self._stream.log_static(paths.MAP_EDGE, rr.LineStrips2D([corners], colors=[_EDGE], radii=screen_radii(0.5)))

    def _draw(self, actor: ActorLife, description: SceneDescription, time: TimePoint) -> None:
        path = paths.actor(actor.id)
        if actor.id in self._present and actor.id in self._boxed:
            self._stream.clear(path, time)
        self._present.add(actor.id)
        self._colors.pop(actor.id, None)
        self.looks.pop(actor.id, None)
        if actor.kind == "vehicle":
            self._vehicles.add(actor.id)
        if actor.kind in ROAD_USERS:
            red, green, blue = style.color_of(actor)
            self._colors[actor.id] = red << 24 | green << 16 | blue << 8 | 255
        if actor.id not in self._boxed and len(self._boxed) >= MOST_BOXES:
            self._left_out.add(actor.id)
            return
        self._boxed.add(actor.id)
        look = description.actors.look_of(actor.id)
        archetypes: list[rr.AsComponents] = [rr.AnyValues(name=style.label_of(actor))]
        if look is not None and self._models < MOST_MODELS:
            self._models += 1
            self.looks[actor.id] = look
            mesh = model_mesh(look)
            archetypes.append(drawn(look, mesh, with_shadow=actor.kind == "vehicle"))
            if actor.kind == "vehicle":
                self._lamps.add(actor.id, mesh)
        elif look is not None or not actor.type_id:
            archetypes.append(_box(actor, look))
        if actor.is_hero or actor.id == self._followed:
            archetypes.append(_name(actor, look))
        if description.batch.index_of(actor.id) is None:
            archetypes.append(_location(actor))
        self._stream.log(path, time, *archetypes)

    def _erase(self, id: int, time: TimePoint) -> None:
        if id in self._present:
            self._present.remove(id)
            self._lamps.remove(id)
            self.looks.pop(id, None)
            if id in self._boxed:
                self._stream.clear(paths.actor(id), time)

    def _hide(self, description: SceneDescription, times: TimeColumns) -> None:
        """Erase actors from when on they are away, and draw them again when they are there."""
        batch = description.batch
        before = np.isin(batch.ids, list(self._away))
        changed = batch.away != np.concatenate((before[None], batch.away[:-1]))
        for row, column in zip(*(index.tolist() for index in np.nonzero(changed)), strict=True):
            id = int(batch.ids[column])
            if batch.away[row, column]:
                self._erase(id, times.point(row))
            elif id not in self._present:
                actor = batch.actors.get(id) or ActorLife.of(Spawn(id), float(batch.time[0]))
                self._draw(actor, description, times.point(row))
        self._away = set(batch.ids[batch.away[-1]].tolist())

    def _lay(self, description: SceneDescription, times: TimeColumns) -> None:
        """Lay down the models of walkers; the transforms of their entities stay those that are recorded."""
        for row, id, fall in description.falls:
            look = description.actors.look_of(id)
            if look is not None:
                matrix = np.eye(3) if fall is None else fall.matrix
                offset = np.zeros(3) if fall is None else fall.offset - matrix @ look.center
                self._stream.log(
                    paths.actor(id), times.point(row), rr.InstancePoses3D(translations=[offset], mat3x3=[matrix])
                )

    def _write_map(self, block: PoseBlock) -> None:
        shown = np.isin(block.ids, list(self._colors))
        colors = np.array([self._colors.get(id, 0) for id in block.ids.tolist()], np.uint32)
        present = block.present[1:] & shown
        locations = block.poses[1:, :, :2][present] * CM
        if len(locations):
            low, high = np.split(self._extent, 2)
            self._extent = np.concatenate((np.minimum(low, locations.min(axis=0)), np.maximum(high, locations.max(axis=0))))
        columns = rr.Points2D.columns(
            positions=locations.astype(np.float32), colors=np.broadcast_to(colors, present.shape)[present]
        )
        lengths = present.sum(axis=1)
        self._stream.columns(
            paths.MAP_ACTORS, block.times.take(slice(1, None)), [column.partition(lengths) for column in columns]
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
    upon = paths.actor(actor.parent) if actor.attached and actor.parent is not None else None
    return rr.Transform3D(
        translation=pose[LOCATION],
        quaternion=rr.Quaternion(xyzw=quaternions(pose)),
        parent_frame=f"tf#{upon}" if upon else None,
    )


def _box(actor: ActorLife, look: Look | None) -> rr.Boxes3D:
    """Return the box of an actor: the edges alone of one that has no look."""
    box = box_of(actor)
    return rr.Boxes3D(
        centers=[(box.x, box.y, box.z)],
        half_sizes=[(box.extent_x, box.extent_y, box.extent_z)],
        colors=[style.color_of(actor) if look is None else look.color],
        fill_mode="majorwireframe" if look is None else "solid",
    )


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
