"""Records of single actors, of what the recorder and clients of a server know of them.

A pose is six numbers, as in `carla_recap.replay.pose`: x, y, z in cm, then roll, pitch, yaw in degrees, left-handed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.records import CM_PER_M, UE4, ActorKind, Physics, RecordType

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.model.layout import Layout

Row = tuple[float, ...]
Pose = tuple[float, float, float, float, float, float]

WITH_POSE: Final = (ActorKind.OTHER, ActorKind.VEHICLE, ActorKind.WALKER)
"""The kinds of actors whose transforms are in each frame, as in CARLA 0.9.13 and later."""
_PHYSICS: Final[RecordType] = UE4.named("physics")
_OTHERS: Final = ("id", "use_gear_auto_box", "center_of_mass_x", "center_of_mass_y", "center_of_mass_z")
PHYSICS_NUMBERS: Final = [
    name for name, kind in _PHYSICS.layout.fields.items() if isinstance(kind, str) and name not in _OTHERS
]
"""The numbers that a `PhysicsControl` has under the names that they have in a record."""


def pose(transform: Any) -> Pose:
    """Return the pose of a transform in m and degrees, of the simulator or of CARLA's client."""
    location, rotation = transform.location, transform.rotation
    return (
        location.x * CM_PER_M,
        location.y * CM_PER_M,
        location.z * CM_PER_M,
        rotation.roll,
        rotation.pitch,
        rotation.yaw,
    )


def box_row(id: int, centre: Any, extent: Any) -> Row:
    """Return the record of a box, of its centre and its extent in m."""
    return (id, *(CM_PER_M * value for value in (centre.x, centre.y, centre.z, extent.x, extent.y, extent.z)))


def physics_record(
    id: int, control: Any, torque_curve: Iterable[Row], steering_curve: Iterable[Row], wheels: Iterable[Row]
) -> Physics:
    """Return the record of the physics of a vehicle, of a `PhysicsControl` or that of CARLA's client; wheels are rows."""
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
        **{name: getattr(control, name) for name in PHYSICS_NUMBERS},
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
