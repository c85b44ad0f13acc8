"""The records of single actors: blueprint, attributes, pose, box, physics and the times of lights, in CARLA's units.

A pose is six numbers, as in `carla_recap.replay.pose`: x, y, z in cm, then roll, pitch, yaw in degrees, left-handed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import UE4, Attribute, Physics, RecordType, Spawn
from carla_recap.sim.actors.attributes import attribute_type
from carla_recap.sim.geometry import Location, Rotation, Transform

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.model.layout import Layout
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.actors.lights import Sign, TrafficLight
    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.physics.physics_control import WheelPhysics
    from carla_recap.sim.town.loading import Town

Row = tuple[float, ...]

_PHYSICS: Final[RecordType] = UE4.named("physics")
_HALF_HEIGHT: Final = 1.0  # m, of trigger volumes, which stand on the road
CM_PER_M: Final = 100.0


def spawn(actor: Actor) -> Spawn:
    """Return the spawn of an actor, in the world or relative to its parent."""
    x, y, z, roll, pitch, yaw = pose(actor.relative_transform)
    attributes = [Attribute(attribute_type(key), key, value) for key, value in actor.attributes.items() if key]
    return Spawn(actor.id, actor.kind, x, y, z, roll, pitch, yaw, actor.blueprint.uid, actor.type_id, attributes)


def bounding_box(actor: Actor) -> Row:
    """Return the box of an actor, in its own axes."""
    centre, extent = actor.box.location, actor.box.extent
    return (actor.id, *(CM_PER_M * value for value in (centre.x, centre.y, centre.z, extent.x, extent.y, extent.z)))


def trigger_volumes(sign: Sign, town: Town) -> list[Row]:
    """Return the trigger volumes of a light or sign: boxes as wide as the lane around each stop line."""
    rows = []
    for lane, s in sign.signal.stops:
        (x, y, z), half_width = town.index.at([lane], [s])[0][0].tolist(), town.lanes[lane].width / 2
        box = (x, y, z + _HALF_HEIGHT, half_width, half_width, _HALF_HEIGHT)
        rows.append((sign.id, *(CM_PER_M * value for value in box)))
    return rows


def light_times(light: TrafficLight) -> Row:
    """Return the times of a traffic light, in s."""
    return light.id, light.green_time, light.yellow_time, light.red_time


def physics(vehicle: Vehicle) -> Physics:
    """Return the physics of a vehicle; the positions of its wheels are in the world, as CARLA records them."""
    control, transform = vehicle.physics_control, vehicle.transform
    centre = control.center_of_mass
    wheels = [_wheel(wheel, transform) for wheel in control.wheels]
    gears: list[Row] = [(gear.ratio, gear.down_ratio, gear.up_ratio) for gear in control.forward_gears]
    return Physics(
        id=vehicle.id,
        max_rpm=control.max_rpm,
        moi=control.moi,
        damping_rate_full_throttle=control.damping_rate_full_throttle,
        damping_rate_zero_throttle_clutch_engaged=control.damping_rate_zero_throttle_clutch_engaged,
        damping_rate_zero_throttle_clutch_disengaged=control.damping_rate_zero_throttle_clutch_disengaged,
        use_gear_auto_box=int(control.use_gear_autobox),
        clutch_strength=control.clutch_strength,
        final_ratio=control.final_ratio,
        mass=control.mass,
        drag_coefficient=control.drag_coefficient,
        center_of_mass_x=centre.x,
        center_of_mass_y=centre.y,
        center_of_mass_z=centre.z,
        torque_curve=_rows("torque_curve", list(control.torque_curve)),
        forward_gears=_rows("forward_gears", gears),
        steering_curve=_rows("steering_curve", list(control.steering_curve)),
        wheels=_rows("wheels", wheels),
    )


def _wheel(wheel: WheelPhysics, transform: Transform) -> Row:
    x, y, z = wheel.position.x / CM_PER_M, wheel.position.y / CM_PER_M, wheel.position.z / CM_PER_M
    position = transform.transform(Location(x, y, z))
    return (
        wheel.tire_friction,
        wheel.damping_rate,
        wheel.max_steer_angle,
        wheel.radius,
        wheel.max_brake_torque,
        wheel.max_handbrake_torque,
        wheel.lat_stiff_max_load,
        wheel.lat_stiff_value,
        wheel.long_stiff_value,
        *(CM_PER_M * value for value in (position.x, position.y, position.z)),
    )


def _rows(field: str, rows: list[Row]) -> NDArray[np.void]:
    many = _PHYSICS.layout.fields[field]
    assert not isinstance(many, str)
    layout: Layout = many.layouts[0]
    return np.array(rows, layout.dtype(wide=False))


def pose(transform: Transform) -> tuple[float, float, float, float, float, float]:
    """Return the pose of a transform."""
    location, rotation = transform.location, transform.rotation
    return (
        location.x * CM_PER_M,
        location.y * CM_PER_M,
        location.z * CM_PER_M,
        rotation.roll,
        rotation.pitch,
        rotation.yaw,
    )


def transform(pose: Iterable[float]) -> Transform:
    """Return the transform of a pose."""
    x, y, z, roll, pitch, yaw = map(float, pose)
    return Transform(Location(x / CM_PER_M, y / CM_PER_M, z / CM_PER_M), Rotation(pitch, yaw, roll))
