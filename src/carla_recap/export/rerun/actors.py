"""Actors as boxes in the world and as points on the map: they appear, move and disappear."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.errors import RecapWarning
from carla_recap.export import style
from carla_recap.export.rerun import paths
from carla_recap.export.rerun.followed import CameraAxes
from carla_recap.export.rerun.poses import PoseBuffer
from carla_recap.export.rerun.stream import screen_radii
from carla_recap.model.records import CM, ActorKind, Spawn
from carla_recap.replay import Destroyed, Present, Spawned, quaternions, right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.export.rerun.poses import PoseBlock
    from carla_recap.export.rerun.stream import Stream, TimeColumns, TimePoint
    from carla_recap.replay import SceneBatch
    from carla_recap.replay.selection import Ids

MOVERS: Final = (ActorKind.VEHICLE, ActorKind.WALKER)
"""The kinds that are on the map and that a camera can follow."""

MOST_BOXES: Final = 5_000
"""The number of actors that have boxes, the first ones; the viewer is too slow to draw more. All are on the map."""

_RADIUS: Final = 3.0  # points of the screen; of an actor on the map
_MARGIN: Final = 15.0  # m
_EDGE: Final = (45, 48, 56)
_ARROW: Final = (235, 240, 250)


class ActorWriter:
    """Writes all actors.

    Args:
        stream: The stream.
        followed: The actor that the camera follows: its name is always shown.
        roads: Whether the map has roads.
        cameras: Ids of other actors that get the axes of a camera, if they are vehicles or walkers.
    """

    def __init__(self, stream: Stream, followed: int | None, *, roads: bool, cameras: Iterable[int]) -> None:
        self._stream = stream
        self._followed = followed
        self._roads = roads
        self._cameras = {id: CameraAxes(stream, paths.camera(id)) for id in cameras if id != followed}
        self._present: set[int] = set()
        self._boxed: set[int] = set() if followed is None else {followed}  # actors that have had a box, or will have one
        self._left_out: set[int] = set()
        self._extent = np.array((np.inf, np.inf, -np.inf, -np.inf))  # of the map: least and greatest x and y
        self._colors: dict[int, int] = {}  # of the actors on the map, and of those removed since the last block
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
        self._followed = id
        self._boxed.add(id)

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        spawned = []
        for event in batch.events:
            if isinstance(event, Spawned):
                self._draw(event.actor, batch, times.point(0))
                spawned.append(event.actor.id)
            elif isinstance(event, Destroyed):
                self._erase(event.id, times.point(0))
        if batch.ids is not self._ids:
            self._ids = batch.ids
            for id in set(batch.ids.tolist()) - self._present:
                self._draw(Present(Spawn(id), float(batch.time[0])), batch, times.point(0))
        self._poses.add(batch, times, spawned)
        if self._poses.is_full:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        block = self._poses.take()
        if block is not None:
            block.write(self._stream, self._boxed)
            self._write_map(block)
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
        if not self._roads and np.isfinite(self._extent).all():
            left, top, right, bottom = self._extent + np.array((-_MARGIN, -_MARGIN, _MARGIN, _MARGIN))
            corners = [(left, top), (right, top), (right, bottom), (left, bottom), (left, top)]
            self._stream.log_static(paths.MAP_EDGE, rr.LineStrips2D([corners], colors=[_EDGE], radii=screen_radii(0.5)))

    def _draw(self, actor: Present, batch: SceneBatch, time: TimePoint) -> None:
        path = paths.actor(actor.id)
        if actor.id in self._present and actor.id in self._boxed:
            self._stream.clear(path, time)
        self._present.add(actor.id)
        self._colors.pop(actor.id, None)
        if actor.kind in MOVERS:
            red, green, blue = style.color_of(actor)
            self._colors[actor.id] = red << 24 | green << 16 | blue << 8 | 255
        if actor.id not in self._boxed and len(self._boxed) >= MOST_BOXES:
            self._left_out.add(actor.id)
            return
        self._boxed.add(actor.id)
        box = style.box_of(actor)
        center = (box.x, box.y, box.z)
        half = (box.extent_x, box.extent_y, box.extent_z)
        boxes = rr.Boxes3D(
            centers=[center],
            half_sizes=[half],
            colors=[style.color_of(actor)],
            labels=[style.label_of(actor)],
            show_labels=actor.is_hero or actor.id == self._followed,
            fill_mode="majorwireframe" if style.is_outlined(actor) else "solid",
        )
        archetypes: list[rr.AsComponents] = [boxes]
        if actor.kind == ActorKind.VEHICLE:
            archetypes.append(_arrow(np.array(center), np.array(half)))
        if batch.index_of(actor.id) is None:
            archetypes.append(_location(actor))
        self._stream.log(path, time, *archetypes)

    def _erase(self, id: int, time: TimePoint) -> None:
        if id in self._present:
            self._present.remove(id)
            if id in self._boxed:
                self._stream.clear(paths.actor(id), time)

    def _write_map(self, block: PoseBlock) -> None:
        shown = np.isin(block.ids, list(self._colors))
        colors = np.array([self._colors.get(id, 0) for id in block.ids.tolist()], np.uint32)
        present = block.present[1:] & shown
        locations = block.poses[1:][present][:, :2] * CM
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
                self._cameras[id].write(times, block.poses[1:, index], np.flatnonzero(block.present[1:, index]))


def _location(actor: Present) -> rr.Transform3D:
    """Return the pose of an actor without recorded poses: that of its spawn, or fixed to its parent."""
    pose = right_handed(actor.spawn_pose)
    upon = paths.actor(actor.parent) if actor.attached and actor.parent is not None else None
    return rr.Transform3D(
        translation=pose[LOCATION],
        quaternion=rr.Quaternion(xyzw=quaternions(pose)),
        parent_frame=f"tf#{upon}" if upon else None,
    )


def _arrow(center: NDArray[np.float64], half: NDArray[np.float64]) -> rr.LineStrips3D:
    """Return an angle on the roof that points forward."""
    corners = np.array([(0.35, 0.75, 1.0), (0.85, 0.0, 1.0), (0.35, -0.75, 1.0)])
    return rr.LineStrips3D([center + corners * half + np.array((0, 0, 0.03))], colors=[_ARROW], radii=[0.06])
