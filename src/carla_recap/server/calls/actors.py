"""Calls about actors: listing, spawning and destroying them, their transforms, and the forces on them."""

from __future__ import annotations

from collections.abc import Awaitable, Generator
from math import degrees, radians
from typing import Any, TypeVar

from carla_recap.model.records import ActorKind
from carla_recap.server import actor_records
from carla_recap.server.actor_records import check_attributes
from carla_recap.server.host import Client
from carla_recap.server.quirks import slightly_aside
from carla_recap.server.rpc.codec import encoder
from carla_recap.server.rpc.registry import CallError, call
from carla_recap.server.rpc.structs import ActorDescription, ActorRecord, BoxStruct
from carla_recap.sim.actors.lights import Sign
from carla_recap.sim.actors.moving import MovingActor, Vehicle, VehicleControl, Walker
from carla_recap.sim.actors.props import Prop
from carla_recap.sim.episode import Actor
from carla_recap.sim.geometry import Location, Transform, Vector
from carla_recap.sim.validation import expect_place, expect_turning, expect_velocity

A = TypeVar("A", bound=Actor)


@call
def get_actor_definitions(client: Client) -> Any:
    """Return all blueprints."""
    return actor_records.encoded_definitions(client.host.world.blueprints, client.release)


@call
def get_spectator(client: Client) -> ActorRecord:
    """Return the spectator."""
    return _record(client, client.host.world.spectator)


@call
def get_actors_by_id(client: Client, ids: list[int]) -> Any:
    """Return the records of actors; unknown ids are left out. Of many actors, others are served in between."""
    actors, encode = client.host.world.actors, encoder(ActorRecord, client.release)

    def records() -> Generator[None, None, list[Any]]:
        found = []
        for id in dict.fromkeys(ids):
            if id in actors:
                found.append(encode(_record(client, actors[id])))
                yield
        return found

    return client.host.take(records(), at_once=not client.connection.is_open)


@call
def spawn_actor(client: Client, description: ActorDescription, transform: Transform) -> ActorRecord | Awaitable[ActorRecord]:
    """Spawn an actor."""
    return _record_when_ready(client, spawn(client, description, transform))


@call
def spawn_actor_with_parent(
    client: Client, description: ActorDescription, transform: Transform, parent: int, attachment: int = 0, bone: str = ""
) -> ActorRecord | Awaitable[ActorRecord]:
    """Spawn an actor that is attached to another; every kind of attachment is a rigid one."""
    return _record_when_ready(client, spawn(client, description, transform, client.host.actor(parent)))


@call
def destroy_actor(client: Client, id: int) -> bool:
    """Destroy an actor; return False if it had been destroyed before."""
    actor = client.host.known_actor(id)
    return isinstance(actor, Actor) and actor.destroy()


@call
def get_actor_bounding_box(client: Client, id: int) -> BoxStruct:
    """Return the box around an actor, even a destroyed one, for which traffic managers ask."""
    return actor_records.box(client.host.known_actor(id))


@call
def set_actor_transform(client: Client, id: int, transform: Transform) -> None:
    """Set the transform of an actor; for an attached one, relative to its parent."""
    _movable(client, id).transform = transform


@call
def set_actor_location(client: Client, id: int, location: Location) -> None:
    """Set the location of an actor; it keeps its rotation."""
    actor = _movable(client, id)
    actor.transform = Transform(location, actor.relative_transform.rotation)


@call
def set_actor_target_velocity(client: Client, id: int, velocity: Vector) -> None:
    """Set the velocity of a vehicle, in m/s; it has no effect on a walker, which has no physical body in CARLA."""
    mover = expect(client, id, MovingActor)
    if isinstance(mover, Vehicle):
        mover.set_target_velocity(velocity)


@call
def set_actor_target_angular_velocity(client: Client, id: int, velocity: Vector) -> None:
    """Set the angular velocity of a vehicle, in degrees/s about z; a walker turns as it walks."""
    mover = expect(client, id, MovingActor)
    if isinstance(mover, Vehicle):
        expect_turning("the angular velocity", velocity, of=mover)
        rows, row = mover.rows, mover.row
        rows.turning[row] = radians(velocity.z)
        rows.angular_velocity[row, 2] = velocity.z


@call
def enable_actor_constant_velocity(client: Client, id: int, velocity: Vector) -> None:
    """Hold the velocity of a vehicle constant, in its own axes and m/s."""
    vehicle = expect(client, id, Vehicle)
    expect_velocity("the velocity", velocity, of=vehicle)
    client.host.constant_velocity.hold(vehicle, velocity)


@call
def disable_actor_constant_velocity(client: Client, id: int) -> None:
    """Stop holding the velocity of a vehicle."""
    client.host.constant_velocity.release(expect(client, id, Vehicle))


@call
def add_actor_impulse(client: Client, id: int, impulse: Vector) -> None:
    """Apply an impulse to a vehicle, in N s and the world's axes; see `set_actor_target_velocity` about walkers."""
    _push(client, id, impulse)


@call
def add_actor_impulse_at_location(client: Client, id: int, impulse: Vector, location: Location) -> None:
    """Apply an impulse to a vehicle at a location, in N s and m and the world's axes."""
    expect_place("the location of an impulse", location)
    centre = expect(client, id, MovingActor).transform.location
    _push(client, id, impulse, degrees((location.x - centre.x) * impulse.y - (location.y - centre.y) * impulse.x))


@call
def add_actor_force(client: Client, id: int, force: Vector) -> None:
    """Apply a force to a vehicle during the next tick, in N and the world's axes."""
    _push(client, id, client.host.world.episode.impulse(force))


@call
def add_actor_force_at_location(client: Client, id: int, force: Vector, location: Location) -> None:
    """Apply a force to a vehicle at a location during the next tick, in N and m and the world's axes."""
    add_actor_impulse_at_location(client, id, client.host.world.episode.impulse(force), location)


@call
def add_actor_angular_impulse(client: Client, id: int, impulse: Vector) -> None:
    """Apply an angular impulse to a vehicle, in kg m² degrees/s about z."""
    _push(client, id, Vector(), impulse.z)


@call
def add_actor_torque(client: Client, id: int, torque: Vector) -> None:
    """Apply a torque to a vehicle during the next tick, in kg m² degrees/s² about z."""
    _push(client, id, Vector(), client.host.world.episode.impulse(torque).z)


@call
def set_actor_simulate_physics(client: Client, id: int, enabled: bool) -> None:
    """Switch the physics of an actor on or off; this has no effect on destroyed and static actors."""
    actor = client.host.known_actor(id)
    if isinstance(actor, MovingActor) and actor.is_alive:
        actor.set_simulate_physics(enabled)


@call
def set_actor_enable_gravity(client: Client, id: int, enabled: bool) -> None:
    """Switch the gravity of a vehicle or walker on or off; without it, the actor keeps its height and has no grip."""
    actor = client.host.known_actor(id)
    if isinstance(actor, MovingActor) and actor.is_alive:
        actor.set_enable_gravity(enabled)


@call
def set_actor_collisions(client: Client, id: int, enabled: bool) -> None:
    """Switch the collisions of an actor on or off; this has no effect on destroyed actors and those without a body."""
    actor = client.host.known_actor(id)
    if isinstance(actor, (MovingActor, Prop)) and actor.is_alive:
        actor.set_collisions(enabled)


@call
def set_actor_dead(client: Client, id: int) -> None:
    """Let a walker fall down for good, or stop a vehicle for good."""
    actor = client.host.actor(id)
    if isinstance(actor, Walker):
        actor.rows.fall(actor.row)
    elif isinstance(actor, Vehicle):
        client.host.ackermann.release(actor)
        client.host.constant_velocity.release(actor)
        actor.set_autopilot(False)
        actor.apply_control(VehicleControl(brake=1.0))


@call
def send(client: Client, id: int, message: Any) -> None:
    """Have a `sensor.other.v2x_custom` send a message in the next tick."""
    client.host.sensors.queue_message(client.host.actor(id), message)


@call
def get_actor_name(client: Client, id: int) -> str:
    """Return the name of an actor in the engine, which is that of its blueprint with its id."""
    actor = client.host.known_actor(id)
    return f"{actor.type_id}_{id}"


@call
def get_actor_class_name(client: Client, id: int) -> str:
    """Return the name of an actor's class in the engine, which is that of its blueprint."""
    return client.host.known_actor(id).type_id


@call
def get_actor_component_world_transform(client: Client, id: int, component: str) -> Transform:
    """Return the transform of a component, which is the actor's own."""
    return client.host.known_actor(id).transform


def spawn(client: Client, description: ActorDescription, transform: Transform, parent: Actor | None = None) -> Actor:
    """Spawn an actor and keep it known after its destruction; a `RecapError` says why that is impossible."""
    host = client.host
    blueprint = host.world.blueprints.get(description.id)
    attributes = {a.id: a.value for a in description.attributes if a.id in blueprint.attributes}
    check_attributes(blueprint, attributes)
    if blueprint.kind is ActorKind.VEHICLE and parent is None:
        transform = slightly_aside(transform)
    actor = host.world.try_spawn(description.id, transform, parent=parent, **attributes)
    if actor is None:
        raise CallError("Spawn failed because of collision at spawn position")
    host.remember(actor)
    host.sensors.prepare(actor)
    return actor


def _record(client: Client, actor: Actor) -> ActorRecord:
    return actor_records.record(actor, client.host.streams, client.release)


def _record_when_ready(client: Client, actor: Actor) -> ActorRecord | Awaitable[ActorRecord]:
    """Return the record of a new actor; of a sensor that needs the surfaces of the town, when these are ready."""
    record, sensors = _record(client, actor), client.host.sensors
    if sensors.is_ready(actor):
        return record

    async def later() -> ActorRecord:
        await sensors.loaded()
        return record

    return later()


def expect(client: Client, id: int, kind: type[A]) -> A:
    """Return an actor that is alive and of a kind, or raise `CallError` or `DeadActor`."""
    actor = client.host.actor(id)
    if not isinstance(actor, kind):
        expected = "vehicle or walker" if kind is MovingActor else kind.__name__
        raise CallError(f"actor {id} is a {actor.type_id}; a {expected} was expected")
    return actor


def _movable(client: Client, id: int) -> Actor:
    actor = client.host.actor(id)
    if isinstance(actor, Sign):
        raise CallError(f"{actor!r} belongs to the town and cannot be moved")
    return actor


def _push(client: Client, id: int, impulse: Vector, turning: float = 0.0) -> None:
    """Apply an impulse in N s, and an angular one in kg m² degrees/s, to a vehicle whose physics is on."""
    mover = expect(client, id, MovingActor)
    if isinstance(mover, Vehicle):
        rows, row = mover.rows, mover.row
        change = turning / rows.moment[row].item()
        expect_turning("the angular velocity", Vector(z=change), of=mover)
        mover.add_impulse(impulse)
        rows.turning[row] += radians(change) * rows.simulated[row]
