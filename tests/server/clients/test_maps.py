"""Maps by all names that clients know them by."""

from __future__ import annotations

import carla
import pytest


def test_yaws_of_spawn_points_are_those_that_vehicles_report(client: carla.Client) -> None:
    world = client.load_world("Town10HD")
    world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
    points = world.get_map().get_spawn_points()
    model = world.get_blueprint_library().find("vehicle.tesla.model3")
    answers = client.apply_batch_sync([carla.command.SpawnActor(model, point) for point in points[::7]], True)
    snapshot = world.get_snapshot()
    for answer, point in zip(answers, points[::7], strict=True):
        assert not answer.error
        assert snapshot.find(answer.actor_id).get_transform().rotation.yaw == pytest.approx(point.rotation.yaw, abs=0.01)
