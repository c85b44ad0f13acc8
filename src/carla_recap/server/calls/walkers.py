"""Calls about walkers."""

from __future__ import annotations

from carla_recap.server.calls.actors import expect
from carla_recap.server.client import Client
from carla_recap.server.table import call
from carla_recap.sim.actors.actors import Walker
from carla_recap.sim.actors.control import WalkerControl
from carla_recap.sim.geometry import Transform, Vector
from carla_recap.sim.validation import expect_velocity


@call
def apply_control_to_walker(client: Client, id: int, control: WalkerControl) -> None:
    """Have a walker walk in a direction."""
    expect(client, id, Walker).apply_control(control)


def set_walker_state(client: Client, id: int, transform: Transform, speed: float) -> None:
    """Put a walker somewhere, and say how fast it walks ahead: what the client does for its walkers, in batches alone.

    One that forces do not move goes nowhere by itself, and is only said to be so fast.
    """
    walker = expect(client, id, Walker)
    expect_velocity(f"the speed of {walker!r}", Vector(speed))
    transform.location.z += walker.box.extent.z  # the client says where its feet are
    walker.transform = transform
    ahead = transform.forward()
    if walker.simulates_physics:
        walker.apply_control(WalkerControl(ahead, speed))
    else:
        walker.set_target_velocity(Vector(ahead.x * speed, ahead.y * speed, ahead.z * speed))
