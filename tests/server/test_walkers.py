"""Calls about walkers."""

from __future__ import annotations

import math

import carla
import pytest

from carla_recap.errors import RecapError
from tests.server.client import FAR, spawn
from tests.server.inside import Inside


@pytest.fixture
def walker(world: carla.World) -> carla.Walker:
    return spawn(world, "walker.pedestrian.0001", FAR)


@pytest.mark.parametrize("simulated", [True, False])
def test_a_walker_is_put_where_the_client_leads_it(
    world: carla.World, client: carla.Client, walker: carla.Walker, simulated: bool
) -> None:
    walker.set_simulate_physics(simulated)
    there = carla.Transform(carla.Location(505.0, 500.0, 0.9), carla.Rotation(yaw=90.0))
    (answer,) = client.apply_batch_sync([carla.command.ApplyWalkerState(walker.id, there, 1.5)], True)
    assert not answer.has_error()
    assert walker.get_location().x == pytest.approx(505.0, abs=1e-3)
    assert walker.get_location().y == pytest.approx(500.075 if simulated else 500.0, abs=1e-3)
    assert (walker.get_velocity().x, walker.get_velocity().y) == pytest.approx((0.0, 1.5), abs=1e-3)


def test_a_walker_has_no_bones(walker: carla.Walker) -> None:
    assert walker.get_bones().bone_transforms == []
    walker.set_bones(carla.WalkerBoneControlIn([("crl_hand__R", carla.Transform())]))
    walker.blend_pose(0.5)
    walker.show_pose()
    walker.hide_pose()
    walker.get_pose_from_animation()


@pytest.mark.parametrize("bad", [math.nan, math.inf, 3e38])
def test_controls_are_numbers(bad: float) -> None:
    inside = Inside()
    walker = inside.world.place("walker.pedestrian.0001", inside.world.town.spawn_points[0])
    with pytest.raises(RecapError, match=r"finite|at most"):
        inside.call("apply_control_to_walker", walker.id, [[1.0, 0.0, 0.0], bad, False])
    with pytest.raises(RecapError, match=r"finite|at most"):
        inside.call("apply_control_to_walker", walker.id, [[bad, 0.0, 0.0], 1.0, False])
    (answer,) = inside.batch([7, [walker.id, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], bad]])
    assert answer[0][0] == 0
    inside.host.tick()
    assert math.isfinite(walker.transform.location.x)
