"""Sixty cars in a town keep their lanes, stop at red lights, and meet none of each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carla_recap.sim import World, load_town
from carla_recap.sim.signals import RED
from carla_recap.sim.town.loading import make_town
from carla_recap.sim.traffic.spawning import populate
from tests.roads.towns import mirrored, town

pytest.importorskip("carla", reason="the extra `carla` is not installed")

SECONDS = 30
NEAR = 6.0  # m: so far from a line a crossing of it is looked for


class Lines:
    """The stop lines of lights, and the cars whose front ends cross them."""

    def __init__(self, world: World) -> None:
        found = [
            (lane, s, row)
            for row, index in enumerate(world.signals.signal.tolist())
            for lane, s in world.town.signals[index].stops
        ]
        lane, s, self._light = (np.array(column) for column in zip(*found, strict=True))
        self._places, heading = world.town.index.at(lane, s)
        self._ahead = np.stack((np.cos(heading), np.sin(heading)))
        self._half = np.array([each.width / 2 for each in world.town.lanes])[lane]
        self._world = world
        self._half_length = np.array([car.box.extent.x for car in world.vehicles.actors])
        self._before = np.full((len(self._half_length), len(found)), np.inf)

    def crossed(self) -> np.ndarray:
        """Return the lights of the lines that were crossed since the previous call, as rows of the signals."""
        vehicles = self._world.vehicles
        yaw = np.radians(vehicles.rotation[:, 1])
        nose = np.stack((np.cos(yaw), np.sin(yaw)))
        away = vehicles.position[:, :2, None] + (nose * self._half_length).T[:, :, None] - self._places[:, :2].T
        beyond = (away * self._ahead).sum(axis=1)
        aside = np.abs(away[:, 1] * self._ahead[0] - away[:, 0] * self._ahead[1])
        along = (nose.T @ self._ahead > 0.8) & (aside < self._half) & (np.abs(beyond) < NEAR)
        crossed = along & (self._before < 0) & (beyond >= 0)
        self._before = beyond
        return self._light[np.nonzero(crossed)[1]]


def named(name):
    if name == "Mirrored":
        return make_town(mirrored(load_town().opendrive), Path("Mirrored.xodr"))
    return load_town(name if name == "Brickfield" else town(name))


@pytest.mark.parametrize("name", ["Brickfield", "Mirrored", "Town01", "Town02", "Town10HD"])
def test_cars_keep_their_lanes_stop_at_red_and_do_not_collide(name):
    """Lanes of right-hand and of left-hand traffic, whose directions are those of CARLA's client: see `test_town`."""
    world = World(named(name), seed=3, date=0)
    populate(world, 60, 0)
    world.settings.collisions_of = "all"
    lines, passed, ran, beside = Lines(world), 0, 0, []
    index, vehicles = world.town.index, world.vehicles
    width = np.array([lane.width for lane in world.town.lanes])
    for tick in range(SECONDS * 20):
        world.tick()
        assert not world.events.collisions
        lights = lines.crossed()
        passed += len(lights)
        ran += int((world.signals.state[lights] == RED).sum())
        if tick % 10 == 0:
            x, y, _ = vehicles.position.T
            lane, s = index.nearest_lane(x, y, heading=np.radians(vehicles.rotation[:, 1]))
            _, right = index.project(lane, x, y, s)
            beside.append(np.abs(right) / (width[lane] / 2))
    shares = np.concatenate(beside)
    assert passed > 20
    assert ran == 0
    assert shares.max() <= 1
    assert np.mean(shares < 0.25) > 0.97  # within half a metre of the middle, but for changes of lane
