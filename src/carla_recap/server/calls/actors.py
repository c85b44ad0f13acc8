"""Calls about actors: what there is, spawning and destroying, where they are and what pushes them."""

from __future__ import annotations

from math import degrees, radians
from typing import Any, TypeVar

from carla_recap.server import actor_records
from carla_recap.server.attributes import check_attributes
from carla_recap.server.client import Client
from carla_recap.server.structs import ActorDescription, ActorRecord, BoundingBox
from carla_recap.server.table import CallError, call
from carla_recap.sim.actors.actors import Actor, Mover, Prop, Sign, Vehicle, Walker
from carla_recap.sim.actors.control import VehicleControl
from carla_recap.sim.geometry import Location, Transform, Vector
from carla_recap.sim.validation import expect_place, expect_push, expect_turning, expect_velocity

A = TypeVar("A", bound=Actor)


@call
def get_actor_definitions(client: Client) -> Any:
    """Return all blueprints."""
    return actor_records.encoded_definitions(client.host.world.blueprints)


@call
def get_spectator(client: Client) -> ActorRecord:
    """Who looks at the world."""
    return actor_records.record(client.host.world.spectator, client.host.streams)


@call
def get_actors_by_id(client: Client, ids: list[int]) -> list[ActorRecord]:
    """Those of some actors that are there."""
    actors = client.host.world.actors
    return [actor_records.record(actors[id], client.host.streams) for id in dict.fromkeys(ids) if id in actors]


@call
def spawn_actor(client: Client, description: ActorDescription, transform: Transform) -> ActorRecord:
    """Let an actor appear."""
    return actor_records.record(spawn(client, description, transform), client.host.streams)


@call
def spawn_actor_with_parent(
    client: Client, description: ActorDescription, transform: Transform, parent: int, attachment: int = 0, bone: str = ""
) -> ActorRecord:
    """Let an actor appear that is fixed to another; every kind of attachment is a rigid one."""
    return actor_records.record(spawn(client, description, transform, client.host.actor(parent)), client.host.streams)


@call
def destroy_actor(client: Client, id: int) -> bool:
    """Take an actor out of the world; False if it had been destroyed before."""
    actor = client.host.actor_or_ghost(id)
    return isinstance(actor, Actor) and actor.destroy()


@call
def get_actor_bounding_box(client: Client, id: int) -> BoundingBox:
    """The box around an actor; also of one that has been destroyed, for which traffic managers ask."""
    return actor_records.box(client.host.actor_or_ghost(id))


@call
def set_actor_transform(client: Client, id: int, transform: Transform) -> None:
    """Put an actor elsewhere; an attached one relative to its parent."""
    _movable(client, id).transform = transform


@call
def set_actor_location(client: Client, id: int, location: Location) -> None:
    """Put an actor elsewhere, turned as it is."""
    actor = _movable(client, id)
    actor.transform = Transform(location, actor.relative_transform.rotation)


@call
def set_actor_target_velocity(client: Client, id: int, velocity: Vector) -> None:
    """Give a vehicle or walker a velocity in m/s."""
    expect(client, id, Mover).set_target_velocity(velocity)


@call
def set_actor_target_angular_velocity(client: Client, id: int, velocity: Vector) -> None:
    """Have a vehicle turn: degrees/s, about z alone. A walker turns as it walks."""
    mover = expect(client, id, Mover)
    expect_turning(f"the turning of {mover!r}", velocity)
    if isinstance(mover, Vehicle):
        rows, row = mover.rows, mover.row
        rows.turning[row] = radians(velocity.z)
        rows.angular_velocity[row, 2] = velocity.z


@call
def enable_actor_constant_velocity(client: Client, id: int, velocity: Vector) -> None:
    """Keep the velocity of a vehicle, in its own axes and m/s."""
    vehicle = expect(client, id, Vehicle)
    expect_velocity(f"the velocity of {vehicle!r}", velocity)
    client.host.steadiness.hold(vehicle, velocity)


@call
def disable_actor_constant_velocity(client: Client, id: int) -> None:
    """Let a vehicle go on as it would."""
    client.host.steadiness.release(expect(client, id, Vehicle))


@call
def add_actor_impulse(client: Client, id: int, impulse: Vector) -> None:
    """Push an actor: N s, in the world."""
    _push(expect(client, id, Mover), impulse)


@call
def add_actor_impulse_at_location(client: Client, id: int, impulse: Vector, location: Location) -> None:
    """Push an actor at a place: N s and m, both in the world."""
    mover = expect(client, id, Mover)
    _turn(mover, _lever(mover, location, impulse))
    _push(mover, impulse)


@call
def add_actor_force(client: Client, id: int, force: Vector) -> None:
    """Push an actor during the next tick: N, in the world."""
    _push(expect(client, id, Mover), _during_tick(client, force))


@call
def add_actor_force_at_location(client: Client, id: int, force: Vector, location: Location) -> None:
    """Push an actor at a place during the next tick: N and m, both in the world."""
    add_actor_impulse_at_location(client, id, _during_tick(client, force), location)


@call
def add_actor_angular_impulse(client: Client, id: int, impulse: Vector) -> None:
    """Turn a vehicle: kg m² degrees/s, about z alone."""
    _turn(expect(client, id, Mover), impulse.z)


@call
def add_actor_torque(client: Client, id: int, torque: Vector) -> None:
    """Turn a vehicle during the next tick: kg m² degrees/s², about z alone."""
    _turn(expect(client, id, Mover), _during_tick(client, torque).z)


@call
def set_actor_simulate_physics(client: Client, id: int, enabled: bool) -> None:
    """Let forces move an actor, or have it stay; nothing is done to who has been destroyed, or never moves."""
    actor = client.host.actor_or_ghost(id)
    if isinstance(actor, Mover) and actor.is_alive:
        actor.set_simulate_physics(enabled)


@call
def set_actor_collisions(client: Client, id: int, enabled: bool) -> None:
    """Let an actor touch others, or pass through them; nothing is done to who has been destroyed, or has no body."""
    actor = client.host.actor_or_ghost(id)
    if isinstance(actor, (Mover, Prop)) and actor.is_alive:
        actor.set_collisions(enabled)


@call
def set_actor_dead(client: Client, id: int) -> None:
    """Have a walker fall down for good, or a vehicle stand without a driver."""
    actor = client.host.actor(id)
    if isinstance(actor, Walker):
        actor.rows.fall(actor.row)
    elif isinstance(actor, Vehicle):
        client.host.ackermann.release(actor)
        client.host.steadiness.release(actor)
        actor.set_autopilot(False)
        actor.apply_control(VehicleControl(brake=1.0))


@call
def get_actor_component_world_transform(client: Client, id: int, component: str) -> Transform:
    """Where a component of an actor is: all are where the actor is."""
    return client.host.actor_or_ghost(id).transform


def spawn(client: Client, description: ActorDescription, transform: Transform, parent: Actor | None = None) -> Actor:
    """Let an actor appear.

    Raises:
        CallError: Its place is occupied, or cannot be one; or an attribute has a value that it cannot have.
        RecapError: There is no such blueprint, or no such parent.
    """
    host = client.host
    blueprint = host.world.blueprints.get(description.id)
    attributes = {a.id: a.value for a in description.attributes if a.id in blueprint.attributes}
    check_attributes(blueprint, attributes)
    actor = host.world.try_spawn(description.id, transform, parent=parent, **attributes)
    if actor is None:
        raise CallError("Spawn failed because of collision at spawn position")
    host.remember(actor)
    return actor


def expect(client: Client, id: int, kind: type[A]) -> A:
    """An actor that is alive, and of a kind.

    Raises:
        CallError: There is none, or it is of another kind.
        DeadActor: It has been destroyed.
    """
    actor = client.host.actor(id)
    if not isinstance(actor, kind):
        expected = "vehicle or walker" if kind is Mover else kind.__name__
        raise CallError(f"actor {id} is a {actor.type_id}; a {expected} was expected")
    return actor


def _movable(client: Client, id: int) -> Actor:
    actor = client.host.actor(id)
    if isinstance(actor, Sign):
        raise CallError(f"{actor!r} belongs to the town and cannot be moved")
    return actor


def _push(mover: Mover, impulse: Vector) -> None:
    """Change the velocity of an actor by an impulse, N s."""
    mass = mover.rows.mass[mover.row].item()
    expect_push(f"an impulse on {mover!r}", impulse, mass)
    if isinstance(mover, Vehicle):
        mover.add_impulse(impulse)
    else:
        velocity = mover.velocity
        mover.set_target_velocity(Vector(velocity.x + impulse.x / mass, velocity.y + impulse.y / mass, velocity.z))


def _turn(mover: Mover, impulse: float) -> None:
    """Change how fast a vehicle turns by an angular impulse, kg m² degrees/s."""
    if isinstance(mover, Vehicle):
        change = impulse / mover.rows.moment[mover.row].item()
        expect_turning(f"the turning of {mover!r}", Vector(z=change))
        mover.rows.turning[mover.row] += radians(change)


def _lever(mover: Mover, place: Location, impulse: Vector) -> float:
    """The angular impulse about z of a push at a place, kg m² degrees/s."""
    expect_place(f"where {mover!r} is pushed", place)
    middle = mover.transform.location
    return degrees((place.x - middle.x) * impulse.y - (place.y - middle.y) * impulse.x)


def _during_tick(client: Client, force: Vector) -> Vector:
    """The impulse of a force that acts for a tick."""
    world = client.host.world
    seconds = world.settings.fixed_delta_seconds or world.delta
    return Vector(force.x * seconds, force.y * seconds, force.z * seconds)
