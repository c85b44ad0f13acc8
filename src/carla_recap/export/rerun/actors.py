"""Actors as boxes in the world and as points on the map: they appear, move and disappear."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.errors import RecapWarning
from carla_recap.export import style
from carla_recap.export.rerun import tree
from carla_recap.export.rerun.cameras import Chase
from carla_recap.export.rerun.stream import screen
from carla_recap.export.rerun.tracks import Tracks
from carla_recap.model.records import CM, ActorKind, Spawn
from carla_recap.replay import Destroyed, Present, Spawned, quaternions, right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Moment, Stream
    from carla_recap.export.rerun.tracks import Block
    from carla_recap.replay import Scene
    from carla_recap.replay.rows import Ids

MOVERS: Final = (ActorKind.VEHICLE, ActorKind.WALKER)
"""The kinds that are on the map and that a camera can follow."""

MOST_BOXES: Final = 5_000
"""So many actors have boxes, the first ones; the viewer draws no more of them in time. All are on the map."""

_ON_MAP: Final = 3.0  # points of the screen
_MARGIN: Final = 15.0  # m
_EDGE: Final = (45, 48, 56)
_ARROW: Final = (235, 240, 250)


class Actors:
    """Writes all actors.

    Args:
        stream: Where to.
        followed: Whom the camera follows: its name is always shown.
        roads: Whether there are roads on the map.
        cameras: Which others get a camera that follows them, too, if they are vehicles or walkers.
    """

    def __init__(self, stream: Stream, followed: int | None, *, roads: bool, cameras: Iterable[int]) -> None:
        self._stream = stream
        self._followed = followed
        self._roads = roads
        self._cameras = {id: Chase(stream, tree.camera(id)) for id in cameras if id != followed}
        self._present: set[int] = set()
        self._boxed: set[int] = set() if followed is None else {followed}  # who has ever had a box, or is to have one
        self._left_out: set[int] = set()
        self._extent = np.array((np.inf, np.inf, -np.inf, -np.inf))  # of the map: least and greatest x and y
        self._colors: dict[int, int] = {}  # of those on the map, and those that went since the last block
        self._tracks = Tracks()
        self._ids: Ids | None = None
        stream.always(tree.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        stream.always(tree.MAP_ACTORS, rr.Points2D.from_fields(radii=screen(_ON_MAP)))

    def follow(self, id: int) -> None:
        """Let the camera follow somebody else."""
        self._followed = id
        self._boxed.add(id)

    def enter(self, scene: Scene, moment: Moment) -> None:
        """Take a scene in."""
        born = []
        for event in scene.events:
            if isinstance(event, Spawned):
                self._draw(event.actor, scene, moment)
                born.append(event.actor.id)
            elif isinstance(event, Destroyed):
                self._erase(event.id, moment)
        if scene.ids is not self._ids:
            self._ids = scene.ids
            for id in set(scene.ids.tolist()) - self._present:
                self._draw(Present(Spawn(id), scene.time), scene, moment)
        self._tracks.add(scene, moment, born)
        if self._tracks.full:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        block = self._tracks.take()
        if block is not None:
            self._move(block)
            self._map(block)
            self._follow(block)
        self._colors = {id: color for id, color in self._colors.items() if id in self._present}

    def close(self) -> None:
        """Write what is held back, and where there are no roads, an edge around the map, so that it keeps its scale.

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
            self._stream.always(tree.MAP_EDGE, rr.LineStrips2D([corners], colors=[_EDGE], radii=screen(0.5)))

    def _draw(self, actor: Present, scene: Scene, moment: Moment) -> None:
        path = tree.actor(actor.id)
        if actor.id in self._present and actor.id in self._boxed:
            self._stream.clear(path, moment)
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
        if scene.index_of(actor.id) is None:
            archetypes.append(_place(actor))
        self._stream.log(path, moment, *archetypes)

    def _erase(self, id: int, moment: Moment) -> None:
        if id in self._present:
            self._present.remove(id)
            if id in self._boxed:
                self._stream.clear(tree.actor(id), moment)

    def _move(self, block: Block) -> None:
        for id, times, transforms in block.tracks(self._boxed):
            self._stream.transforms(tree.actor(id), times, transforms)

    def _map(self, block: Block) -> None:
        shown = [place for place, id in enumerate(block.ids.tolist()) if id in self._colors]
        colors = np.array([self._colors[id] for id in block.ids[shown].tolist()], np.uint32)
        there = block.there[shown, 1:].T
        places = block.poses[shown, 1:, :2].swapaxes(0, 1)[there] * CM
        if len(places):
            low, high = np.split(self._extent, 2)
            self._extent = np.concatenate((np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))))
        columns = rr.Points2D.columns(
            positions=places.astype(np.float32), colors=np.broadcast_to(colors, there.shape)[there]
        )
        lengths = there.sum(axis=1)
        self._stream.columns(
            tree.MAP_ACTORS, block.times.take(slice(1, None)), [column.partition(lengths) for column in columns]
        )

    def _follow(self, block: Block) -> None:
        times = block.times.take(slice(1, None))
        for place, id in enumerate(block.ids.tolist()):
            if id in self._cameras and id in self._colors:
                self._cameras[id].move(times, block.poses[place, 1:], np.flatnonzero(block.there[place, 1:]))


def _place(actor: Present) -> rr.Transform3D:
    """Where an actor without recorded poses is: where it was spawned, or fixed to its parent."""
    pose = right_handed(actor.spawn_pose)
    upon = tree.actor(actor.parent) if actor.attached and actor.parent is not None else None
    return rr.Transform3D(
        translation=pose[LOCATION],
        quaternion=rr.Quaternion(xyzw=quaternions(pose)),
        parent_frame=f"tf#{upon}" if upon else None,
    )


def _arrow(center: NDArray[np.float64], half: NDArray[np.float64]) -> rr.LineStrips3D:
    """An angle on the roof that points forward."""
    corners = np.array([(0.35, 0.75, 1.0), (0.85, 0.0, 1.0), (0.35, -0.75, 1.0)])
    return rr.LineStrips3D([center + corners * half + np.array((0, 0, 0.03))], colors=[_ARROW], radii=[0.06])
