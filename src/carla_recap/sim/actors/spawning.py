"""Spawning: the actors of an episode with their bodies, and the lights and signs of its town."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import ActorKind
from carla_recap.sim import blueprints
from carla_recap.sim.actors.lights import Sign, TrafficLight
from carla_recap.sim.actors.moving import MovingActor, Vehicle, Walker
from carla_recap.sim.actors.props import Prop, Sensor
from carla_recap.sim.actors.triggers import FrictionTrigger
from carla_recap.sim.errors import SpawnError
from carla_recap.sim.physics.physics_control import LEAST_MASS
from carla_recap.sim.physics.plane import PROP, VEHICLE, WALKER, WALL
from carla_recap.sim.town.junctions import SignalKind
from carla_recap.sim.town.loading import POLE_RADIUS
from carla_recap.sim.validation import expect_text, expect_transform

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pymunk

    from carla_recap.sim.blueprints import Blueprint
    from carla_recap.sim.episode import Actor, Episode
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.town.junctions import Signal

_WALKER_MASS: Final = 75.0  # kg
_WALKER_RADIUS: Final = 0.25  # m, of the shoulders
_WALKER_HALF: Final = 0.19  # m: half of the width of a walker as vehicles perceive it, whatever the size of its box
_FALSE: Final = ("false", "0", "no", "off")
_CLASSES: Final[dict[ActorKind, type[Actor]]] = {
    ActorKind.VEHICLE: Vehicle,
    ActorKind.WALKER: Walker,
    ActorKind.SENSOR: Sensor,
}


def place(
    episode: Episode,
    blueprint: Blueprint | str,
    transform: Transform,
    parent: Actor | None = None,
    attributes: Mapping[str, str] | None = None,
    wanted_id: int | None = None,
) -> Actor:
    """Spawn an actor, even where others are, relative to the parent that it is attached to, if there is one.

    It gets the wanted id if no actor has, or had, it, else the next one. `SpawnError`: there is no such blueprint or
    attribute; `SimError`: the place is too far away for a recording, or an attribute too long for one; `DeadActor`: the
    parent is gone.
    """
    attributes = attributes or {}
    blueprint = episode.blueprints.resolve(blueprint, attributes)
    expect_transform("the transform", transform, of=blueprint.id)
    for key, value in attributes.items():
        expect_text(key, value, of=blueprint.id)
    if parent is not None:
        parent.check()
    make = _CLASSES.get(blueprint.kind, Prop) if blueprint.id != blueprints.FRICTION_TRIGGER else FrictionTrigger
    actor = make(episode, episode.ids.new(wanted_id), blueprint, transform, dict(attributes), parent)
    episode.add(actor)
    if isinstance(actor, FrictionTrigger):
        episode.triggers.append(actor)
    elif isinstance(actor, MovingActor):
        _add_row(actor, transform if parent is None else parent.transform.attached(transform))
    elif isinstance(actor, Prop) and parent is None and actor.box.extent.length() > 0:
        actor.body = _own(actor, episode.plane.add_box(PROP, _corners(blueprint), None))
        actor.transform = transform
    if parent is not None:
        episode.pending.parented.append((actor.id, parent.id))
        if isinstance(actor, MovingActor):
            actor.attach()
    return actor


def spawn(
    episode: Episode,
    blueprint: Blueprint | str,
    transform: Transform,
    parent: Actor | None = None,
    attributes: Mapping[str, str] | None = None,
) -> Actor:
    """Spawn an actor, as `place` does; `SpawnError`, too, if its place is occupied."""
    blueprint = episode.blueprints.resolve(blueprint, attributes or {})
    if parent is None and (other := _occupant(episode, blueprint, transform)) is not None:
        location = transform.location
        where = f"({location.x:.1f}, {location.y:.1f}, {location.z:.1f})"
        raise SpawnError(f"{blueprint.id} cannot be spawned at {where}: {other!r} is there")
    return place(episode, blueprint, transform, parent, attributes)


def try_spawn(
    episode: Episode,
    blueprint: Blueprint | str,
    transform: Transform,
    parent: Actor | None = None,
    attributes: Mapping[str, str] | None = None,
) -> Actor | None:
    """Spawn an actor if its place is free; see `place`."""
    blueprint = episode.blueprints.resolve(blueprint, attributes or {})
    if parent is None and _occupant(episode, blueprint, transform) is not None:
        return None
    return place(episode, blueprint, transform, parent, attributes)


def _occupant(episode: Episode, blueprint: Blueprint, transform: Transform) -> Actor | None:
    """Return an actor that the box of a blueprint would overlap; None if its place is free."""
    expect_transform("the transform", transform, of=blueprint.id)
    if blueprint.box.extent.length() == 0:
        return None
    location, yaw = transform.location, np.radians(transform.rotation.yaw).item()
    heights = blueprint.box.heights(transform)
    bodies = episode.plane.overlapping(_corners(blueprint), location.x, location.y, yaw, heights)
    return next((episode.owners[body] for body in bodies if body in episode.owners), None)


def add_signs(episode: Episode) -> None:
    """Add the lights and signs of the town, with their poles; see `Town.poles`."""
    lights: list[int] = []
    for signal, pole in zip(episode.town.signals, episode.town.poles, strict=True):
        if signal.kind is SignalKind.LIGHT:
            sign: Sign = TrafficLight(episode, episode.ids.new(), blueprints.TRAFFIC_LIGHT, signal, len(lights))
            lights.append(sign.id)
        else:
            sign = Sign(episode, episode.ids.new(), _sign_blueprint(signal), signal)
        episode.add(sign)
        if pole is not None:
            _add_pole(sign, pole)
    episode.signals.id[:] = lights


def _add_pole(sign: Sign, heights: tuple[float, float]) -> None:
    """Add a pole with the z of its lowest and of its highest point."""
    location, plane = sign.signal.transform.location, sign.episode.plane
    body = _own(sign, plane.add_disc(WALL, POLE_RADIUS, None))
    plane.set_heights(body, lambda: heights)
    plane.move(body, location.x, location.y, 0.0)


def _own(actor: Actor, body: pymunk.Body) -> pymunk.Body:
    actor.episode.owners[body.id] = actor
    actor.episode.plane.set_heights(body, actor.heights)
    return body


def _add_row(mover: MovingActor, transform: Transform) -> None:
    """Add a vehicle or walker to the arrays of its episode."""
    columns, plane = _columns(mover, transform), mover.episode.plane
    if isinstance(mover, Vehicle):
        physics = mover.blueprint.physics
        assert physics is not None
        body = _own(mover, plane.add_box(VEHICLE, _corners(mover.blueprint), max(physics.mass, LEAST_MASS)))
        sticky = mover.attributes.get("sticky_control", "true").lower() not in _FALSE
        row = mover.rows.add(mover, body, **columns, sticky=sticky)
        mover.rows.set_physics(row, physics, mover.box)
    else:
        body = _own(mover, plane.add_disc(WALKER, _WALKER_RADIUS, _WALKER_MASS))
        mover.rows.add(mover, body, **columns, half_height=mover.box.extent.z, mass=_WALKER_MASS)


def _columns(mover: MovingActor, transform: Transform) -> dict[str, float | tuple[float, float, float]]:
    location, turn, extent = transform.location, transform.rotation, mover.box.extent
    half = (_WALKER_HALF, _WALKER_HALF) if isinstance(mover, Walker) else (extent.x, extent.y)
    return {
        "position": (location.x, location.y, location.z),
        "rotation": (turn.pitch, turn.yaw, turn.roll),
        "half_length": half[0],
        "half_width": half[1],
        "bottom": mover.box.location.z - extent.z,
        "top": mover.box.location.z + extent.z,
    }


def _corners(blueprint: Blueprint) -> list[tuple[float, float]]:
    """Return the outline of a blueprint's box from above."""
    centre, extent = blueprint.box.location, blueprint.box.extent
    return [(centre.x + x * extent.x, centre.y + y * extent.y) for x, y in ((1, 1), (1, -1), (-1, -1), (-1, 1))]


def _sign_blueprint(signal: Signal) -> Blueprint:
    if signal.kind is SignalKind.SPEED_LIMIT:
        return blueprints.speed_limit((signal.speed_limit or 0.0) * 3.6)
    return blueprints.STOP_SIGN if signal.kind is SignalKind.STOP else blueprints.YIELD_SIGN
