"""The records of single actors, as far as a client gets their data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.records import UE4, ActorKind, Attribute, Physics, Spawn
from carla_recap.sim.recording.packets import CM_PER_M

if TYPE_CHECKING:
    import carla
    from numpy.typing import NDArray

    from carla_recap.model.layout import Layout
    from carla_recap.model.records import RecordType

    Row = tuple[float, ...]
    Pose = tuple[float, float, float, float, float, float]
    Types = dict[str, dict[str, int]]

_STRING: Final = 3
_TYPES_FROM: Final = 1  # clients number the types of attributes from 1, recordings from 0
_KINDS: Final = {
    "vehicle.": ActorKind.VEHICLE,
    "walker.": ActorKind.WALKER,
    "traffic.traffic_light": ActorKind.TRAFFIC_LIGHT,
    "traffic.": ActorKind.TRAFFIC_SIGN,
    "sensor.": ActorKind.SENSOR,
}
_PHYSICS: Final[RecordType] = UE4.named("physics")
_NOT_PLAIN: Final = ("id", "use_gear_auto_box", "center_of_mass_x", "center_of_mass_y", "center_of_mass_z")
_PLAIN: Final = [name for name, kind in _PHYSICS.layout.fields.items() if isinstance(kind, str) and name not in _NOT_PLAIN]


def kind_of(type_id: str) -> ActorKind:
    """Return the kind of an actor, by its blueprint."""
    return next((kind for begin, kind in _KINDS.items() if type_id.startswith(begin)), ActorKind.OTHER)


def attribute_types(library: carla.BlueprintLibrary) -> Types:
    """Return the types of the attributes of each blueprint, as recordings number them."""
    return {blueprint.id: {each.id: int(each.type) - _TYPES_FROM for each in blueprint} for blueprint in library}


def spawn(actor: carla.Actor, pose: Pose, types: Types) -> Spawn:
    """Return the spawn of an actor, without the number of its blueprint, which clients do not get.

    Args:
        actor: The actor.
        pose: Its pose, in cm and degrees.
        types: The types of attributes.
    """
    known = types.get(actor.type_id, {})
    attributes = [Attribute(known.get(key, _STRING), key, value) for key, value in actor.attributes.items() if key]
    return Spawn(actor.id, kind_of(actor.type_id), *pose, type_id=actor.type_id, attributes=attributes)


def bounding_box(actor: carla.Actor) -> list[Row]:
    """Return the box of an actor, in its own axes, if it has one; asks the server."""
    volume = actor.bounding_box
    return [(actor.id, *_volume(volume.location, volume.extent))] if volume.extent.length() > 0 else []


def trigger_volume(sign: carla.TrafficSign) -> list[Row]:
    """Return the trigger volume of a light or sign, if it has one."""
    volume = sign.trigger_volume
    if not volume.extent.length():
        return []
    return [(sign.id, *_volume(sign.get_transform().transform(volume.location), volume.extent))]


def light_times(light: carla.TrafficLight) -> Row:
    """Return the times of a traffic light, in s."""
    return light.id, light.get_green_time(), light.get_yellow_time(), light.get_red_time()


def physics(vehicle: carla.Vehicle) -> Physics:
    """Return the physics of a vehicle; asks the server."""
    control = vehicle.get_physics_control()
    centre = control.center_of_mass
    return Physics(
        id=vehicle.id,
        use_gear_auto_box=int(control.use_gear_autobox),
        center_of_mass_x=centre.x,
        center_of_mass_y=centre.y,
        center_of_mass_z=centre.z,
        torque_curve=_rows("torque_curve", control.torque_curve),
        forward_gears=_rows("forward_gears", control.forward_gears),
        steering_curve=_rows("steering_curve", control.steering_curve),
        wheels=_rows("wheels", map(_Wheel, control.wheels)),
        **{name: getattr(control, name) for name in _PLAIN},
    )


class _Wheel:
    """A wheel with its position in three fields."""

    def __init__(self, wheel: carla.WheelPhysicsControl) -> None:
        self._wheel = wheel
        self.position_x, self.position_y, self.position_z = wheel.position.x, wheel.position.y, wheel.position.z

    def __getattr__(self, name: str) -> Any:
        return getattr(self._wheel, name)


def _rows(field: str, parts: Any) -> NDArray[np.void]:
    many = _PHYSICS.layout.fields[field]
    assert not isinstance(many, str)
    layout: Layout = many.layouts[0]
    return np.array([tuple(getattr(part, name) for name in layout.fields) for part in parts], layout.dtype(wide=False))


def _volume(centre: carla.Location, extent: carla.Vector3D) -> Row:
    return tuple(CM_PER_M * value for value in (centre.x, centre.y, centre.z, extent.x, extent.y, extent.z))
