"""The records of single actors: blueprint, attributes, box, physics and the times of lights, in CARLA's units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.packets import PHYSICS_NUMBERS, box_row, physics_record, pose, wheel_row
from carla_recap.model.records import CM_PER_M, Attribute, Physics, Spawn
from carla_recap.sim.attributes import attribute_type
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.physics.physics_control import Gear, PhysicsControl, WheelPhysics
from carla_recap.sim.validation import MAX_ANGLE, MAX_COORDINATE

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from carla_recap.model.packets import Row
    from carla_recap.sim.actors.lights import Sign, TrafficLight
    from carla_recap.sim.actors.moving import Vehicle
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.physics.moving_bodies import MovingBodies
    from carla_recap.sim.town.loading import Town
    from carla_recap.util.arrays import Booleans, Floats

_OLD_TYRES: Final = {"lat_stiff_max_load": 2.0, "lat_stiff_value": 17.0, "long_stiff_value": 1000.0}
"""The tyres of UE4, which CARLA has recorded since 0.9.12."""
_OLD_SWITCH_TIME: Final = 0.5  # s, of UE4
_NEAR: Final = 200.0  # cm between the middle of the wheels and its usual place; users may have moved them
_ALIKE: Final = 0.25  # the least size of a rectangle of wheels, as a share of the usual one
_FARTHEST: Final = np.repeat((MAX_COORDINATE * CM_PER_M, MAX_ANGLE), 3)  # of a pose
_ROLL_PITCH_YAW: Final = [2, 0, 1]
"""Their indices in the rotations of `MovingBodies`."""
_HALF_HEIGHT: Final = 1.0  # m, of trigger volumes, which stand on the road


def spawn(actor: Actor) -> Spawn:
    """Return the spawn of an actor, in the world or relative to its parent."""
    x, y, z, roll, pitch, yaw = pose(actor.relative_transform)
    attributes = [Attribute(attribute_type(key), key, value) for key, value in actor.attributes.items() if key]
    return Spawn(actor.id, actor.kind, x, y, z, roll, pitch, yaw, actor.blueprint.uid, actor.type_id, attributes)


def poses(movers: MovingBodies) -> Floats:
    """Return the poses of all vehicles, or of all walkers, (n, 6)."""
    return np.hstack((movers.position * CM_PER_M, movers.rotation[:, _ROLL_PITCH_YAW]))


def bounding_box(actor: Actor) -> Row:
    """Return the box of an actor, in its own axes."""
    return box_row(actor.id, actor.box.location, actor.box.extent)


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


def physics_control(record: Physics, pose: Sequence[float], usual: PhysicsControl) -> PhysicsControl:
    """Return the physics of a vehicle as a record has it.

    The pose is that of the vehicle in the same frame. A record does not tell how long it takes to shift, nor do those of
    CARLA up to 0.9.11 have the stiffness of tyres, which was UE4's then, as was the time to shift.
    """
    names = [name for name in record.wheels.dtype.names or () if not name.startswith("position_")]
    is_old = "long_stiff_value" not in names
    wheels = []
    for row, position in zip(record.wheels, _own_places(record, pose, usual), strict=True):
        values = {name: float(row[name]) for name in names}
        wheels.append(WheelPhysics(**(_OLD_TYRES if is_old else {}) | values, position=position))
    return PhysicsControl(
        torque_curve=tuple((float(x), float(y)) for x, y in record.torque_curve),
        use_gear_autobox=bool(record.use_gear_auto_box),
        gear_switch_time=_OLD_SWITCH_TIME if is_old else usual.gear_switch_time,
        forward_gears=[Gear(*map(float, gear)) for gear in record.forward_gears],
        center_of_mass=Vector(record.center_of_mass_x, record.center_of_mass_y, record.center_of_mass_z),
        steering_curve=tuple((float(x), float(y)) for x, y in record.steering_curve),
        wheels=wheels,
        **{name: getattr(record, name) for name in PHYSICS_NUMBERS},
    )


def _own_places(record: Physics, pose: Sequence[float], usual: PhysicsControl) -> list[Vector]:
    """Return the places of the wheels of a record in the axes of the vehicle, in cm.

    In the record, they are in the world. Where they are far from the usual ones at the pose, the vehicle had moved on: they
    are turned and shifted as a whole to the usual ones, as near as possible. Places that do not look like those of wheels
    become the usual ones.
    """
    known = [wheel.position for wheel in usual.wheels]
    usually = np.array([place.x + 1j * place.y for place in known])
    with np.errstate(invalid="ignore"):  # NaN
        wheels = record.wheels["position_x"] + 1j * record.wheels["position_y"].astype(np.float64)
        own = (wheels - complex(*pose[:2])) * np.exp(-1j * np.radians(pose[5]))
    if len(wheels) == len(usually) and np.isfinite(wheels).all():
        centre, wheels = usually.mean(), wheels - wheels.mean()
        if abs(own.mean() - centre) < _NEAR:
            return [Vector(at.real, at.imag) for at in own.tolist()]
        turn = np.vdot(wheels, usually - centre)
        if abs(turn) > _ALIKE * np.vdot(usually - centre, usually - centre).real:
            return [Vector(at.real, at.imag) for at in (wheels * turn / abs(turn) + centre).tolist()]
    return [*known, *[Vector()] * len(wheels)][: len(wheels)]


def possible(poses: Floats) -> Booleans:
    """Return whether actors can have poses."""
    found: Booleans = np.all(np.abs(poses) <= _FARTHEST, axis=-1)
    return found


def transform(pose: Iterable[float]) -> Transform:
    """Return the transform of a pose."""
    x, y, z, roll, pitch, yaw = map(float, pose)
    return Transform(Location(x / CM_PER_M, y / CM_PER_M, z / CM_PER_M), Rotation(pitch, yaw, roll))
