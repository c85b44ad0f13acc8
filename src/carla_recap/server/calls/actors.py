"""Calls about actors: what there is, spawning and destroying, where they are and what pushes them."""

from __future__ import annotations

from carla_recap.server import actor_records
from carla_recap.server.calls.table import CallError, call
from carla_recap.server.client import Client
from carla_recap.server.structs import ActorDefinition, ActorDescription, ActorRecord, BoundingBox
from carla_recap.sim.actors import Actor
from carla_recap.sim.geometry import Transform


@call
def get_actor_definitions(client: Client) -> list[ActorDefinition]:
    """All blueprints."""
    return [actor_records.definition(blueprint) for blueprint in client.host.world.blueprints]


@call
def get_spectator(client: Client) -> ActorRecord:
    """Who looks at the world."""
    return actor_records.record(client.host.world.spectator, client.host.streams)


@call
def get_actors_by_id(client: Client, ids: list[int]) -> list[ActorRecord]:
    """Those of some actors that are there."""
    actors = client.host.world.actors
    return [actor_records.record(actors[id], client.host.streams) for id in ids if id in actors]


@call
def spawn_actor(client: Client, description: ActorDescription, transform: Transform) -> ActorRecord:
    """Let an actor appear."""
    return actor_records.record(spawn(client, description, transform), client.host.streams)


@call
def spawn_actor_with_parent(
    client: Client, description: ActorDescription, transform: Transform, parent: int, attachment: int = 0, bone: str = ""
) -> ActorRecord:
    """Let an actor appear that is fixed to another."""
    return actor_records.record(spawn(client, description, transform, client.host.actor(parent)), client.host.streams)


@call
def destroy_actor(client: Client, id: int) -> bool:
    """Take an actor out of the world."""
    return client.host.actor(id).destroy()


@call
def get_actor_bounding_box(client: Client, id: int) -> BoundingBox:
    """The box around an actor; also of one that has been destroyed, for which traffic managers ask."""
    return actor_records.box(client.host.actor_or_ghost(id))


def spawn(client: Client, description: ActorDescription, transform: Transform, parent: Actor | None = None) -> Actor:
    """Let an actor appear.

    Raises:
        CallError: Its place is occupied.
        RecapError: There is no such blueprint, or no such parent.
    """
    attributes = {attribute.id: attribute.value for attribute in description.attributes}
    actor = client.host.world.try_spawn(description.id, transform, parent=parent, **attributes)
    if actor is None:
        raise CallError("Spawn failed because of collision at spawn position")
    return actor
