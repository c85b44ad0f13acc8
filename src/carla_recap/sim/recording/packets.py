"""The records of single actors: blueprint, attributes, pose, box, physics and the times of lights, in CARLA's units.

A pose is six numbers, as in `carla_recap.replay.pose`: x, y, z in cm, then roll, pitch, yaw in degrees, left-handed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.records import UE4, Attribute, Physics, RecordType, Spawn
from carla_recap.sim.attributes import attribute_type
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.physics.physics_control import Gear, PhysicsControl, WheelPhysics

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.model.layout import Layout
    from carla_recap.sim.actors.lights import Sign, TrafficLight
    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.town.loading import Town

Row = tuple[float, ...]
Pose = tuple[float, float, float, float, float, float]

_PHYSICS: Final[RecordType] = UE4.named("physics")
_OLD_TYRES: Final = {"lat_stiff_max_load": 2.0, "lat_stiff_value": 17.0, "long_stiff_value": 1000.0}
"""The tyres of UE4, which CARLA has recorded since 0.9.12."""
_OLD_SWITCH_TIME: Final = 0.5  # s, of UE4
_LONGEST: Final = 2000.0  # cm between a vehicle and its wheels
_HALF_HEIGHT: Final = 1.0  # m, of trigger volumes, which stand on the road
CM_PER_M: Final = 100.0
_OTHERS: Final = ("id", "use_gear_auto_box", "center_of_mass_x", "center_of_mass_y", "center_of_mass_z")
_SAME: Final = [name for name, kind in _PHYSICS.layout.fields.items() if isinstance(kind, str) and name not in _OTHERS]
"""The numbers that a `PhysicsControl` has under the names that they have in a record."""


def spawn(actor: Actor) -> Spawn:
    """Return the spawn of an actor, in the world or relative to its parent."""
    x, y, z, roll, pitch, yaw = pose(actor.relative_transform)
    attributes = [Attribute(attribute_type(key), key, value) for key, value in actor.attributes.items() if key]
    return Spawn(actor.id, actor.kind, x, y, z, roll, pitch, yaw, actor.blueprint.uid, actor.type_id, attributes)


def bounding_box(actor: Actor) -> Row:
    """Return the box of an actor, in its own axes."""
    return box_row(actor.id, actor.box.location, actor.box.extent)


def box_row(id: int, centre: Any, extent: Any) -> Row:
    """Return the record of a box, of its centre and its extent in m."""
    return (id, *(CM_PER_M * value for value in (centre.x, centre.y, centre.z, extent.x, extent.y, extent.z)))


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
    wheels = []
    for wheel in control.wheels:
        x, y, z = wheel.position.x / CM_PER_M, wheel.position.y / CM_PER_M, wheel.position.z / CM_PER_M
        place = transform.transform(Location(x, y, z))
        wheels.append(wheel_row(wheel, (CM_PER_M * place.x, CM_PER_M * place.y, CM_PER_M * place.z)))
    return physics_record(vehicle.id, control, control.torque_curve, control.steering_curve, wheels)


def physics_record(
    id: int, control: Any, torque_curve: Iterable[Row], steering_curve: Iterable[Row], wheels: Iterable[Row]
) -> Physics:
    """Return the record of the physics of a vehicle.

    Args:
        id: The id of the vehicle.
        control: A `PhysicsControl`, or that of CARLA's client.
        torque_curve: Its curve as pairs of numbers.
        steering_curve: Its curve as pairs of numbers.
        wheels: Its wheels as rows.
    """
    centre = control.center_of_mass
    gears = ((gear.ratio, gear.down_ratio, gear.up_ratio) for gear in control.forward_gears)
    return Physics(
        id=id,
        use_gear_auto_box=int(control.use_gear_autobox),
        center_of_mass_x=centre.x,
        center_of_mass_y=centre.y,
        center_of_mass_z=centre.z,
        torque_curve=_rows("torque_curve", torque_curve),
        forward_gears=_rows("forward_gears", gears),
        steering_curve=_rows("steering_curve", steering_curve),
        wheels=_rows("wheels", wheels),
        **{name: getattr(control, name) for name in _SAME},
    )


def physics_control(record: Physics, place: Pose, usual: PhysicsControl) -> PhysicsControl:
    """Return the physics of a vehicle as a record has it.

    Args:
        record: The record; its wheels have places in the world.
        place: The pose of the vehicle at that time; far from the wheels, they get their usual places.
        usual: The usual physics of such a vehicle: a record does not tell how long it takes to shift, nor do those of
            CARLA up to 0.9.11 have the stiffness of tyres, which was UE4's then, as was the time to shift.
    """
    names = [name for name in record.wheels.dtype.names or () if not name.startswith("position_")]
    is_old = "long_stiff_value" not in names
    yaw = np.radians(place[5])
    along, aside = record.wheels["position_x"] - place[0], record.wheels["position_y"] - place[1]
    near = len(record.wheels) and float(np.hypot(along, aside).max()) < _LONGEST
    wheels = []
    for number, row in enumerate(record.wheels):
        values = {name: float(row[name]) for name in names}
        if near:
            x, y = float(along[number]), float(aside[number])
            position = Vector(np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x)
        else:
            position = usual.wheels[number].position if number < len(usual.wheels) else Vector()
        wheels.append(WheelPhysics(**(_OLD_TYRES if is_old else {}) | values, position=position))
    return PhysicsControl(
        torque_curve=tuple((float(x), float(y)) for x, y in record.torque_curve),
        use_gear_autobox=bool(record.use_gear_auto_box),
        gear_switch_time=_OLD_SWITCH_TIME if is_old else usual.gear_switch_time,
        forward_gears=[Gear(*map(float, gear)) for gear in record.forward_gears],
        center_of_mass=Vector(record.center_of_mass_x, record.center_of_mass_y, record.center_of_mass_z),
        steering_curve=tuple((float(x), float(y)) for x, y in record.steering_curve),
        wheels=wheels,
        **{name: getattr(record, name) for name in _SAME},
    )


def wheel_row(wheel: Any, position: Row) -> Row:
    """Return a wheel as a row; its position is in cm."""
    return (*(getattr(wheel, name) for name in _OF_WHEELS), *position)


def _rows(field: str, rows: Iterable[Row]) -> NDArray[np.void]:
    return np.array(list(rows), _layout(field).dtype(wide=False))


def _layout(field: str) -> Layout:
    many = _PHYSICS.layout.fields[field]
    assert not isinstance(many, str)
    layout: Layout = many.layouts[0]
    return layout


_OF_WHEELS: Final = [name for name in _layout("wheels").fields if not name.startswith("position_")]


def pose(transform: Transform) -> Pose:
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
