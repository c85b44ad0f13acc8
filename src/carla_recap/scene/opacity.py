"""What is see-through: what hides the followed actor from a camera, and the followed actor where it hides another one."""

from __future__ import annotations

import math
from itertools import groupby
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION, YAW, rotations

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from carla_recap.scene.description import LookColumns, SceneDescription
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.util.arrays import Booleans, Floats, Indices

    Triple = tuple[float, float, float]

SEE_THROUGH: Final = 0.4
"""The opacity of the followed actor while it hides another one."""
IN_THE_WAY: Final = 0.25
"""The opacity of an actor that hides the followed one."""

_REACH: Final = 60.0  # m; actors farther from the camera are small
_FLAT: Final = 0.3  # m; lower boxes, such as debris that is driven over, hide nothing and need not be seen
_COVERED: Final = 0.25  # the part of the followed actor's box from which on what covers it is in the way
_HIDDEN: Final = 0.5  # the part of an actor's box that is hidden, from which on the followed actor is see-through
_BESIDE: Final = 0.3  # m; a line of sight that passes a box so closely is blocked by it
_STEP: Final = 0.4  # s between the moments at which opacities are looked at
_HELD: Final = 1.0  # s for which an actor stays see-through in viewers
_CORNERS: Final = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)


class SeenBoxes(NamedTuple):
    """The boxes of actors."""

    locations: Floats  # their centres in m, right-handed, (n, 3)
    rotations: Floats  # matrices whose columns point forward, left and up, (n, 3, 3)
    half_extents: Floats  # half their sizes in m, (n, 3)


def is_flat(half_extents: Floats) -> Booleans:
    """Return whether boxes are too low to hide anything, and need not be seen, given half their sizes, (…, 3)."""
    return np.asarray(2 * half_extents[..., 2] < _FLAT)


def is_near(locations: Floats, eyes: Floats) -> Booleans:
    """Return whether locations are near enough to a camera to matter; both in m, (…, 3)."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(((locations - eyes) ** 2).sum(axis=-1) < _REACH**2)


def wanted_opacities(eyes: Floats, axes: Floats, own: SeenBoxes, others: SeenBoxes, at: Indices) -> tuple[Floats, Floats]:
    """Return the opacity of the followed actor in some scenes, (scenes,), and of other actors near the camera, (others,).

    Args:
        eyes: The locations of the camera in m, right-handed, (scenes, 3).
        axes: Matrices whose columns point forward, left and up in its picture, (scenes, 3, 3).
        own: The followed actor in each scene.
        others: Other actors in these scenes.
        at: The scene of each, (others,).
    """
    opacity, other_opacity = np.ones(len(eyes)), np.ones(len(at))
    depth, lower, upper = _projected(own, eyes, axes)
    other_depth, other_lower, other_upper = _projected(others, eyes[at], axes[at])
    with np.errstate(invalid="ignore", over="ignore"):
        common = np.clip(np.minimum(upper[at], other_upper) - np.maximum(lower[at], other_lower), 0, None).prod(axis=1)
        in_sight = (depth[at].min(axis=1) > 0) & (common > 0) & (other_depth.min(axis=1) > 0)
        behind = other_depth.min(axis=1) > depth[at].min(axis=1)
        hidden = in_sight & behind & (common > _HIDDEN * (other_upper - other_lower).prod(axis=1))
        covers = in_sight & ~behind & (common > _COVERED * (upper - lower)[at].prod(axis=1))
        around = (other_depth.min(axis=1) <= 0) & (other_depth.max(axis=1) > 0)  # of the camera: there is no projection
    covers[around] = _blocks(eyes[at[around]], own.locations[at[around]], SeenBoxes(*(column[around] for column in others)))
    opacity[at[hidden]] = SEE_THROUGH
    other_opacity[covers] = IN_THE_WAY
    return opacity, other_opacity


def _projected(boxes: SeenBoxes, eyes: Floats, axes: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the depths of the corners in m, (n, 8), and the least and greatest slopes in the picture, (n, 2) each."""
    corners = (boxes.half_extents[:, None] * _CORNERS) @ np.swapaxes(boxes.rotations, 1, 2) + boxes.locations[:, None]
    seen = (corners - eyes[:, None]) @ axes
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = seen[..., 1:] / seen[..., :1]
    return seen[..., 0], slopes.min(axis=1), slopes.max(axis=1)


def _blocks(eyes: Floats, targets: Floats, boxes: SeenBoxes) -> Booleans:
    """Return whether boxes are between points, or so near to the line between them that they have the eye inside."""
    from_centre = np.einsum("nij,ni->nj", boxes.rotations, eyes - boxes.locations)
    along = np.einsum("nij,ni->nj", boxes.rotations, targets - eyes)
    half = boxes.half_extents + _BESIDE
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack(((-half - from_centre) / along, (half - from_centre) / along))
    enters, leaves = np.fmin(*ends).max(axis=1), np.fmax(*ends).min(axis=1)
    return np.asarray((enters < leaves) & (leaves > 0) & (enters < 1))


class OpacityChange(NamedTuple):
    """A change of the opacity of an actor, in one of the scenes."""

    row: int
    id: int
    opacity: float


class _Moments(NamedTuple):
    """The scenes of a batch that are looked at: their positions, the actors, their poses, and whether these are shown."""

    rows: Indices
    actors: LookColumns
    poses: Floats
    shown: Booleans


class SteppedOpacity:
    """The opacities of actors for viewers that do not fade: looked at every 0.4 s, and held for a second.

    The camera is behind the followed actor, in its calm axes.
    """

    def __init__(self, id: int) -> None:
        self._id = id
        self._step = -math.inf
        self._moments: list[_Moments] = []
        self._count = 0  # of the scenes since the latest changes
        self._shown: dict[int, tuple[float, float]] = {}  # the opacity, and the time until which it is held

    def add(self, description: SceneDescription) -> None:
        """Add the next scenes."""
        steps = np.floor(description.batch.time / _STEP + 1e-6)
        rows = np.flatnonzero(np.diff(steps, prepend=self._step))
        self._step = steps[-1]
        if len(rows) and description.actors.look_of(self._id) is not None:
            poses, shown = description.poses[rows], description.shown[rows]
            self._moments.append(_Moments(self._count + rows, description.actors, poses, shown))
        self._count += len(description)

    def changes(
        self, series: FollowedSeries, eye: Callable[[Triple | None], Triple], pitch: float
    ) -> Iterator[OpacityChange]:
        """Yield the changes in the scenes that were added since the last call.

        Args:
            series: The followed actor in these.
            eye: Returns where the camera is in the calm axes, in m, given half the size of the followed actor's box.
            pitch: Its pitch in degrees; downwards is negative.
        """
        moments, self._moments, self._count = self._moments, [], 0
        for _, group in groupby(moments, key=lambda each: id(each.actors)):
            yield from self._changes(_joined(list(group)), series, eye, pitch)

    def _changes(
        self, moments: _Moments, series: FollowedSeries, eye: Callable[[Triple | None], Triple], pitch: float
    ) -> Iterator[OpacityChange]:
        """Yield the changes in scenes with the same looks."""
        known = series.known[moments.rows]
        rows, actors = moments.rows[known], moments.actors
        poses, shown = moments.poses[known], moments.shown[known]
        look = actors.look_of(self._id)
        if not len(rows) or look is None:
            return
        camera = series.camera[rows]
        wanted = self._wanted(actors, poses, shown, right_handed(camera), np.array(eye(look.half_extents)), pitch)
        for index, row in enumerate(rows.tolist()):
            if index in wanted or self._shown:
                self._forget(set(self._shown) - set(actors.ids[shown[index]].tolist()))
                yield from self._update(row, float(series.time[row]), wanted.get(index, {}))

    def _forget(self, gone: set[int]) -> None:
        """Forget actors that are no longer there."""
        for id in gone:
            del self._shown[id]

    def _update(self, row: int, time: float, wanted: Mapping[int, float]) -> Iterator[OpacityChange]:
        for id, opacity in wanted.items():
            if id not in self._shown:
                yield OpacityChange(row, id, opacity)
            self._shown[id] = opacity, time + _HELD
        for id, (_, until) in list(self._shown.items()):
            if not time < until:
                del self._shown[id]
                yield OpacityChange(row, id, 1.0)

    def _wanted(
        self, actors: LookColumns, poses: Floats, shown: Booleans, camera: Floats, eye: Floats, pitch: float
    ) -> dict[int, dict[int, float]]:
        """Return the opacities below 1 by id, by the position of the scene, given the axes of the camera in each."""
        eyes = camera[:, LOCATION] + rotations(camera) @ eye
        tall = np.flatnonzero((actors.ids != self._id) & ~is_flat(actors.half_extents.astype(np.float64)))
        at, which = np.nonzero(is_near(poses[:, tall, LOCATION], eyes[:, None]) & shown[:, tall])
        found: dict[int, dict[int, float]] = {}
        if not len(at):
            return found
        which, scenes = tall[which], np.arange(len(poses))
        looking = np.zeros_like(camera)
        looking[:, YAW - 1], looking[:, YAW] = -pitch, camera[:, YAW]
        own = np.full(len(poses), actors.ids.searchsorted(self._id))
        opacity, other_opacity = wanted_opacities(
            eyes, rotations(looking), _boxes(actors, own, poses[scenes, own]), _boxes(actors, which, poses[at, which]), at
        )
        for scene in np.flatnonzero(opacity < 1).tolist():
            found.setdefault(scene, {})[self._id] = float(opacity[scene])
        for pair in np.flatnonzero(other_opacity < 1).tolist():
            found.setdefault(int(at[pair]), {})[int(actors.ids[which[pair]])] = float(other_opacity[pair])
        return found


def _joined(moments: Sequence[_Moments]) -> _Moments:
    """Return what is looked at in batches with the same looks, one after the other."""
    rows, _, poses, shown = zip(*moments, strict=True)
    return _Moments(np.concatenate(rows), moments[0].actors, np.concatenate(poses), np.concatenate(shown))


def _boxes(actors: LookColumns, which: Indices, poses: Floats) -> SeenBoxes:
    """Return the boxes of some of the actors, (n,), given their poses in m, right-handed, (n, 6)."""
    turns = rotations(poses)
    centers = poses[:, LOCATION] + np.einsum("nij,nj->ni", turns, actors.centers[which])
    return SeenBoxes(centers, turns, actors.half_extents[which].astype(np.float64))
