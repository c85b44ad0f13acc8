"""The actors of the world as cameras and rays meet them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.model.lives import ActorLife, BoundingBox
from carla_recap.model.packets import pose
from carla_recap.model.presence import RoadHeights
from carla_recap.replay.pose import right_handed
from carla_recap.scene.actor_instances import instances
from carla_recap.scene.appearance import look_of
from carla_recap.scene.description import LookColumns
from carla_recap.scene.lamps import VehicleLamps, lamps_of_lights, lamps_of_vehicles
from carla_recap.sim.actors.lights import Sign
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.episode import transforms
from carla_recap.sim.recording.packets import poses, spawn

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.scene.appearance import Look
    from carla_recap.scene.instances import Instances
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.physics.moving_bodies import MovingBodies
    from carla_recap.sim.world import World

    Rows = NDArray[np.intp]


class WorldActors:
    """What is drawn of the actors of a world.

    The columns that do not change are made anew when actors are spawned or destroyed.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._key: tuple[int, ...] = ()
        self._looks: dict[int, Look | None] = {}
        self._frame: tuple[int, int] | None = None
        self._latest: Instances | None = None
        self._lamps = VehicleLamps()

    def instances(self) -> Instances:
        """Return the instances after the latest tick."""
        frame = self._world.episode.number, self._world.frame
        if self._latest is None or frame != self._frame or tuple(self._world.actors) != self._key:
            self._latest, self._frame = self._make(), frame
        return self._latest

    def _make(self) -> Instances:
        world, key = self._world, tuple(self._world.actors)
        if key != self._key:
            self._assemble(list(world.actors.values()))
            self._key = key
        for movers, (rows, sources) in ((world.vehicles, self._vehicles), (world.walkers, self._walkers)):
            self._poses[rows] = poses(movers)[sources]
        own, others = self._others
        self._poses[own] = np.array([pose(transform) for transform in transforms(others)]).reshape(-1, 6)
        found = instances(self._actors, right_handed(self._poses), *self._lamps_and_steering())
        away = self._heights.away(found.ids, self._poses[None])[0]
        return found.take(~away) if away.any() else found

    def _assemble(self, actors: Sequence[Actor]) -> None:
        """Make the columns that do not change."""
        looks = {actor.id: self._looks[actor.id] if actor.id in self._looks else _look(actor) for actor in actors}
        self._looks = looks
        drawn = sorted((actor for actor in actors if looks[actor.id] is not None), key=lambda actor: actor.id)
        ids = [actor.id for actor in drawn]
        self._heights = RoadHeights([ActorLife.of(spawn(actor), 0.0) for actor in actors])
        self._poses = np.zeros((len(ids), 6))
        self._actors = LookColumns(np.array(ids, np.uint32), [look for id in ids if (look := looks[id]) is not None])
        row_of = {id: row for row, id in enumerate(ids)}
        self._vehicles = _paired(row_of, self._world.vehicles)
        self._walkers = _paired(row_of, self._world.walkers)
        lights = [(row_of[light.id], row) for row, light in enumerate(self._world.traffic_lights) if light.id in row_of]
        self._lights: tuple[Rows, Rows] = _columns(lights)
        others = [actor for actor in drawn if not isinstance(actor, (MovingActor, Sign))]
        self._others = [row_of[actor.id] for actor in others], others
        for row, actor in enumerate(drawn):
            if isinstance(actor, Sign):
                self._poses[row] = pose(actor.transform)

    def _lamps_and_steering(self) -> tuple[NDArray[np.uint64], NDArray[np.float64]]:
        """Return the lit lamps of all that are drawn, and the angles of their front wheels; see `instances`."""
        lamps, steering = np.zeros(len(self._actors.ids), np.uint64), np.zeros(len(self._actors.ids))
        rows, sources = self._lights
        lamps[rows] = lamps_of_lights(self._world.signals.state[sources])
        vehicles = self._world.vehicles
        rows, sources = self._vehicles
        flags = self._lamps.flags_at(
            self._world.elapsed,
            vehicles.id[sources].astype(np.uint32),
            vehicles.light_state[sources],
            vehicles.brake[sources],
            vehicles.reverse[sources],
        )
        lamps[rows] = lamps_of_vehicles(flags)
        steering[rows] = -vehicles.wheel_angle[sources]
        return lamps, steering


def _look(actor: Actor) -> Look | None:
    centre, extent = actor.box.location, actor.box.extent
    box = BoundingBox(centre.x, -centre.y, centre.z, extent.x, extent.y, extent.z) if extent.length() else None
    return look_of(actor.type_id, actor.kind, actor.attributes, box, id=actor.id)


def _paired(row_of: Mapping[int, int], movers: MovingBodies) -> tuple[Rows, Rows]:
    """Return the rows of moving actors among all that are drawn, and their rows in their struct of arrays."""
    return _columns((row_of[id], source) for source, id in enumerate(movers.id.tolist()) if id in row_of)


def _columns(pairs: Iterable[tuple[int, int]]) -> tuple[Rows, Rows]:
    rows, sources = np.array(list(pairs), np.intp).reshape(-1, 2).T
    return rows, sources
