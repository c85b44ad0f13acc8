from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CurvePoint(_message.Message):
    __slots__ = ("x", "y")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ...) -> None: ...

class Gear(_message.Message):
    __slots__ = ("ratio", "down_ratio", "up_ratio")
    RATIO_FIELD_NUMBER: _ClassVar[int]
    DOWN_RATIO_FIELD_NUMBER: _ClassVar[int]
    UP_RATIO_FIELD_NUMBER: _ClassVar[int]
    ratio: float
    down_ratio: float
    up_ratio: float
    def __init__(self, ratio: _Optional[float] = ..., down_ratio: _Optional[float] = ..., up_ratio: _Optional[float] = ...) -> None: ...

class Wheel(_message.Message):
    __slots__ = ("tire_friction", "damping_rate", "max_steer_angle", "radius", "max_brake_torque", "max_handbrake_torque", "lat_stiff_max_load", "lat_stiff_value", "long_stiff_value", "position_x", "position_y", "position_z")
    TIRE_FRICTION_FIELD_NUMBER: _ClassVar[int]
    DAMPING_RATE_FIELD_NUMBER: _ClassVar[int]
    MAX_STEER_ANGLE_FIELD_NUMBER: _ClassVar[int]
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    MAX_BRAKE_TORQUE_FIELD_NUMBER: _ClassVar[int]
    MAX_HANDBRAKE_TORQUE_FIELD_NUMBER: _ClassVar[int]
    LAT_STIFF_MAX_LOAD_FIELD_NUMBER: _ClassVar[int]
    LAT_STIFF_VALUE_FIELD_NUMBER: _ClassVar[int]
    LONG_STIFF_VALUE_FIELD_NUMBER: _ClassVar[int]
    POSITION_X_FIELD_NUMBER: _ClassVar[int]
    POSITION_Y_FIELD_NUMBER: _ClassVar[int]
    POSITION_Z_FIELD_NUMBER: _ClassVar[int]
    tire_friction: float
    damping_rate: float
    max_steer_angle: float
    radius: float
    max_brake_torque: float
    max_handbrake_torque: float
    lat_stiff_max_load: float
    lat_stiff_value: float
    long_stiff_value: float
    position_x: float
    position_y: float
    position_z: float
    def __init__(self, tire_friction: _Optional[float] = ..., damping_rate: _Optional[float] = ..., max_steer_angle: _Optional[float] = ..., radius: _Optional[float] = ..., max_brake_torque: _Optional[float] = ..., max_handbrake_torque: _Optional[float] = ..., lat_stiff_max_load: _Optional[float] = ..., lat_stiff_value: _Optional[float] = ..., long_stiff_value: _Optional[float] = ..., position_x: _Optional[float] = ..., position_y: _Optional[float] = ..., position_z: _Optional[float] = ...) -> None: ...

class Physics(_message.Message):
    __slots__ = ("id", "max_rpm", "moi", "damping_rate_full_throttle", "damping_rate_zero_throttle_clutch_engaged", "damping_rate_zero_throttle_clutch_disengaged", "use_gear_auto_box", "clutch_strength", "final_ratio", "mass", "drag_coefficient", "center_of_mass_x", "center_of_mass_y", "center_of_mass_z", "torque_curve", "forward_gears", "steering_curve", "wheels")
    ID_FIELD_NUMBER: _ClassVar[int]
    MAX_RPM_FIELD_NUMBER: _ClassVar[int]
    MOI_FIELD_NUMBER: _ClassVar[int]
    DAMPING_RATE_FULL_THROTTLE_FIELD_NUMBER: _ClassVar[int]
    DAMPING_RATE_ZERO_THROTTLE_CLUTCH_ENGAGED_FIELD_NUMBER: _ClassVar[int]
    DAMPING_RATE_ZERO_THROTTLE_CLUTCH_DISENGAGED_FIELD_NUMBER: _ClassVar[int]
    USE_GEAR_AUTO_BOX_FIELD_NUMBER: _ClassVar[int]
    CLUTCH_STRENGTH_FIELD_NUMBER: _ClassVar[int]
    FINAL_RATIO_FIELD_NUMBER: _ClassVar[int]
    MASS_FIELD_NUMBER: _ClassVar[int]
    DRAG_COEFFICIENT_FIELD_NUMBER: _ClassVar[int]
    CENTER_OF_MASS_X_FIELD_NUMBER: _ClassVar[int]
    CENTER_OF_MASS_Y_FIELD_NUMBER: _ClassVar[int]
    CENTER_OF_MASS_Z_FIELD_NUMBER: _ClassVar[int]
    TORQUE_CURVE_FIELD_NUMBER: _ClassVar[int]
    FORWARD_GEARS_FIELD_NUMBER: _ClassVar[int]
    STEERING_CURVE_FIELD_NUMBER: _ClassVar[int]
    WHEELS_FIELD_NUMBER: _ClassVar[int]
    id: int
    max_rpm: float
    moi: float
    damping_rate_full_throttle: float
    damping_rate_zero_throttle_clutch_engaged: float
    damping_rate_zero_throttle_clutch_disengaged: float
    use_gear_auto_box: bool
    clutch_strength: float
    final_ratio: float
    mass: float
    drag_coefficient: float
    center_of_mass_x: float
    center_of_mass_y: float
    center_of_mass_z: float
    torque_curve: _containers.RepeatedCompositeFieldContainer[CurvePoint]
    forward_gears: _containers.RepeatedCompositeFieldContainer[Gear]
    steering_curve: _containers.RepeatedCompositeFieldContainer[CurvePoint]
    wheels: _containers.RepeatedCompositeFieldContainer[Wheel]
    def __init__(self, id: _Optional[int] = ..., max_rpm: _Optional[float] = ..., moi: _Optional[float] = ..., damping_rate_full_throttle: _Optional[float] = ..., damping_rate_zero_throttle_clutch_engaged: _Optional[float] = ..., damping_rate_zero_throttle_clutch_disengaged: _Optional[float] = ..., use_gear_auto_box: _Optional[bool] = ..., clutch_strength: _Optional[float] = ..., final_ratio: _Optional[float] = ..., mass: _Optional[float] = ..., drag_coefficient: _Optional[float] = ..., center_of_mass_x: _Optional[float] = ..., center_of_mass_y: _Optional[float] = ..., center_of_mass_z: _Optional[float] = ..., torque_curve: _Optional[_Iterable[_Union[CurvePoint, _Mapping]]] = ..., forward_gears: _Optional[_Iterable[_Union[Gear, _Mapping]]] = ..., steering_curve: _Optional[_Iterable[_Union[CurvePoint, _Mapping]]] = ..., wheels: _Optional[_Iterable[_Union[Wheel, _Mapping]]] = ...) -> None: ...

class VehiclePhysics(_message.Message):
    __slots__ = ("frame", "elapsed", "vehicles", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    VEHICLES_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    vehicles: _containers.RepeatedCompositeFieldContainer[Physics]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., vehicles: _Optional[_Iterable[_Union[Physics, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
