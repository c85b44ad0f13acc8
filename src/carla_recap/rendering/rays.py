"""Rays against boxes, and against the surfaces of a town and the shapes of actors, by Embree.

Axes are right-handed, but boxes alone may be in any axes.
"""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import MissingExtra
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.scene.mesh import Mesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.scene.instances import Instances
    from carla_recap.scene.models import Model
    from carla_recap.util.arrays import Floats, Integers


_PARALLEL: Final = 1e-12  # instead of 0, for a ray along a side of a box
_MOST_PAIRS: Final = 1 << 16  # of rays and boxes that are compared at once: few enough for one thread of BLAS
_THIN: Final = 1e-4  # m: half of the least size of an actor
_TAG_OF_ACTOR: Final = 255


class RayHits(NamedTuple):
    """The hits of rays on boxes."""

    ray: Integers  # the index of the ray of each hit, ascending
    box: Integers  # the index of the box
    distance: Floats  # the distance in m
    cosine: Floats  # the cosine of the angle between the ray and the normal of the side that it hits

    def take(self, index: Integers | NDArray[np.bool_]) -> RayHits:
        """Return some of the hits."""
        return RayHits(self.ray[index], self.box[index], self.distance[index], self.cosine[index])


class OrientedBoxes:
    """Boxes that are turned in any way.

    Args:
        centres: Their centres in m, (n, 3).
        axes: Matrices whose columns are the directions of their sides, (n, 3, 3).
        half_extents: Half of their sizes in m, (n, 3).
    """

    def __init__(self, centres: Floats, axes: Floats, half_extents: Floats) -> None:
        self._centre = centres
        self._axes = axes
        self._extent = half_extents

    def cast(self, origin: Floats, directions: Floats, reach: float) -> RayHits:
        """Return the first hit of each ray that hits something.

        All rays have one origin, (3,) in m, directions of length 1, (n, 3), and a length in m.
        """
        hits = self.pierce(origin, directions, reach)
        return hits.take(np.unique(hits.ray, return_index=True)[1])

    def pierce(self, origin: Floats, directions: Floats, reach: float) -> RayHits:
        """Return all hits of rays that pass through boxes, the nearest of each ray first; see `cast`."""
        ray, box = self._candidates(origin, directions, reach)
        start = ((origin - self._centre)[:, None] @ self._axes)[box, 0]
        along = (directions[ray][:, None] @ self._axes[box])[:, 0]
        along = np.where(np.abs(along) < _PARALLEL, _PARALLEL, along)
        extent = self._extent[box]
        enter = (-np.sign(along) * extent - start) / along
        leave = (np.sign(along) * extent - start) / along
        side = enter.argmax(axis=1)
        distance = np.maximum(enter.max(axis=1), 0.0)
        cosine = np.abs(np.take_along_axis(along, side[:, None], 1)[:, 0])
        hit = np.flatnonzero((distance <= leave.min(axis=1)) & (distance <= reach))
        return RayHits(ray, box, distance, cosine).take(hit[np.lexsort((distance[hit], ray[hit]))])

    def _candidates(self, origin: Floats, directions: Floats, reach: float) -> tuple[Integers, Integers]:
        """Return the pairs of rays and boxes where the ray passes through the sphere around the box."""
        to = self._centre - origin
        size = np.linalg.norm(self._extent, axis=1)
        away = np.linalg.norm(to, axis=1)
        boxes = np.flatnonzero(away - size <= reach)
        least = np.sqrt(np.maximum(away[boxes] ** 2 - size[boxes] ** 2, 0.0))  # the projection of a ray that touches it
        least[away[boxes] <= size[boxes]] = -np.inf
        rows = max(_MOST_PAIRS // max(len(boxes), 1), 1)
        found = [np.empty(0, np.int64)]
        for first in range(0, len(directions), rows):
            touched = np.flatnonzero(directions[first : first + rows] @ to[boxes].T >= least)
            found.append(touched + first * len(boxes))
        ray, box = np.divmod(np.concatenate(found), max(len(boxes), 1))
        return ray, boxes[box]


class SurfaceHits(NamedTuple):
    """The first hits of rays on a town and the actors in it."""

    ray: Integers  # the index of the ray of each hit, ascending
    actor: Integers  # the id of the actor; 0 for the town
    distance: Floats  # the distance in m
    cosine: Floats  # the cosine of the angle between the ray and the normal of the surface
    tag: Integers  # the semantic tag

    def take(self, index: Integers | NDArray[np.bool_]) -> SurfaceHits:
        """Return some of the hits."""
        return SurfaceHits(self.ray[index], self.actor[index], self.distance[index], self.cosine[index], self.tag[index])

    @classmethod
    def joined(cls, parts: Sequence[SurfaceHits], firsts: Sequence[int]) -> SurfaceHits:
        """Return the hits of parts of the rays, at least one, as those of all, given the index of each part's first ray."""
        moved = [part._replace(ray=part.ray + first) for part, first in zip(parts, firsts, strict=True)]
        return cls(*map(np.concatenate, zip(*moved, strict=True)))


class RayScene:
    """A town and the models of actors for rays: those whose instances are at the moment that is asked for.

    Rays may be cast from several threads at a time. A model, by the number that instances have, is asked for when a ray
    first meets its box.

    Raises:
        MissingExtra: Embree is not installed.
    """

    def __init__(self, tiles: Sequence[Mesh], models: Sequence[Model]) -> None:
        self._device = _device()
        town = Mesh.concatenate(tiles)
        self._town = _RayShape(self._device, town) if len(town.triangles) else None
        self._shapes = models
        self._models: dict[int, _RayShape] = {}
        self._lock = Lock()  # for the models that are read

    def cast(self, origin: Floats, directions: Floats, reach: float, instances: Instances | None = None) -> SurfaceHits:
        """Return the first hit of each ray that hits something.

        For the rays, see `OrientedBoxes.cast`.
        """
        count = len(directions)
        distance, actor = np.full(count, reach), np.zeros(count, np.int64)
        cosine, tag = np.zeros(count), np.full(count, -1, np.int64)
        if self._town is not None:
            starts = np.repeat(origin[None].astype(np.float32), count, axis=0)
            ray, far, normal, found = self._town.cast(starts, directions, distance)
            distance[ray], cosine[ray], tag[ray] = far, _cosine(normal, directions[ray]), found
        hits = None if instances is None else self._actor_hits(origin, directions, distance, instances)
        if hits is not None:
            distance[hits.ray], cosine[hits.ray] = hits.distance, hits.cosine
            actor[hits.ray], tag[hits.ray] = hits.actor, hits.tag
        hit = np.flatnonzero(tag >= 0)
        return SurfaceHits(hit, actor[hit], distance[hit], cosine[hit], tag[hit])

    def _actor_hits(self, origin: Floats, directions: Floats, distance: Floats, instances: Instances) -> SurfaceHits | None:
        """Return the first hits on actors of the rays that hit some before a distance; None if there are none."""
        poses = np.concatenate((instances.locations, instances.rotations.reshape(-1, 9)), axis=1)
        impossible = np.flatnonzero(~np.isfinite(poses).all(axis=1))
        if len(impossible):
            instances = instances.take(np.delete(np.arange(len(instances)), impossible))
        axes = instances.rotations.astype(np.float64)
        half = np.maximum(instances.half_extents.astype(np.float64), _THIN)
        boxes = OrientedBoxes(instances.locations, axes, half)
        pairs = boxes.pierce(origin, directions, float(distance.max(initial=0.0)))
        pairs = pairs.take(pairs.distance <= distance[pairs.ray])
        if not len(pairs.ray):
            return None
        starts = (((origin - instances.locations)[:, None] @ axes)[:, 0] / half)[pairs.box]
        along = (directions[pairs.ray][:, None] @ axes[pairs.box])[:, 0] / half[pairs.box]
        numbers, found = instances.models[pairs.box], []
        for number in np.unique(numbers).tolist():
            rows = np.flatnonzero(numbers == number)
            index, far, normal, tag = self._model(number).cast(starts[rows], along[rows], distance[pairs.ray[rows]])
            found.append((rows[index], far, normal, tag))
        pair, far, normal, tag = (np.concatenate(values) for values in zip(*found, strict=True))
        order = np.lexsort((far, pairs.ray[pair]))
        ray, first = np.unique(pairs.ray[pair[order]], return_index=True)
        nearest = order[first]
        pair, far, normal, tag = pair[nearest], far[nearest], normal[nearest], tag[nearest]
        box = pairs.box[pair]
        outward = (axes[box] @ (normal / half[box])[:, :, None])[:, :, 0]
        tag = np.where(tag == _TAG_OF_ACTOR, instances.tags[box], tag)
        return SurfaceHits(ray, instances.ids[box].astype(np.int64), far, _cosine(outward, directions[ray]), tag)

    def _model(self, number: int) -> _RayShape:
        with self._lock:
            if number not in self._models:
                self._models[number] = _RayShape(self._device, self._shapes[number].mesh)
            return self._models[number]


class _RayShape:
    """A mesh for rays."""

    def __init__(self, device: Any, mesh: Mesh) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        tags = [_TAG_OF_ACTOR if (tag := MATERIALS[material].tag) is None else tag for material in Material]
        self._tags = np.array(tags, np.int64)[mesh.materials[mesh.triangles[:, 0]]]
        self._scene = EmbreeScene(device) if len(mesh.triangles) else None
        if self._scene is not None:
            vertices = np.ascontiguousarray(mesh.vertices, np.float32)
            TriangleMesh(self._scene, vertices, np.ascontiguousarray(mesh.triangles, np.int32))
            self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # the first one builds its tree

    def cast(
        self, starts: NDArray[Any], directions: Floats, reach: Floats
    ) -> tuple[Integers, Floats, Floats, NDArray[np.int64]]:
        """Return the rays that hit it, and the distance, the normal (of any length) and the tag of each hit.

        Directions need not have the length 1: distances are multiples of them.
        """
        if self._scene is None or not len(directions):
            nothing = np.empty(0, np.int64)
            return nothing, np.empty(0), np.empty((0, 3)), nothing
        rays = (np.ascontiguousarray(values, np.float32) for values in (starts, directions, reach))
        hits = self._scene.run(*rays, query="INTERSECT", output=True)
        index = np.flatnonzero((hits["primID"] >= 0) & (hits["tfar"] < reach))
        triangle = hits["primID"][index]
        return index, hits["tfar"][index].astype(np.float64), hits["Ng"][index].astype(np.float64), self._tags[triangle]


def _device() -> Any:
    try:
        from embreex.rtcore import EmbreeDevice
    except ImportError:
        raise MissingExtra("rays that meet the ground", "cameras") from None
    return EmbreeDevice()


def _cosine(normals: Floats, directions: Floats) -> Floats:
    squares = np.einsum("ij,ij->i", normals, normals)
    cosine: Floats = np.abs(np.einsum("ij,ij->i", normals, directions)) / np.sqrt(np.where(squares > 0, squares, 1.0))
    return cosine
