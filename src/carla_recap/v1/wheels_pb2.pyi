from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class WheelLocation(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    WHEEL_LOCATION_FRONT_LEFT: _ClassVar[WheelLocation]
    WHEEL_LOCATION_FRONT_RIGHT: _ClassVar[WheelLocation]
    WHEEL_LOCATION_BACK_LEFT: _ClassVar[WheelLocation]
    WHEEL_LOCATION_BACK_RIGHT: _ClassVar[WheelLocation]
    WHEEL_LOCATION_MIDDLE_LEFT: _ClassVar[WheelLocation]
    WHEEL_LOCATION_MIDDLE_RIGHT: _ClassVar[WheelLocation]
WHEEL_LOCATION_FRONT_LEFT: WheelLocation
WHEEL_LOCATION_FRONT_RIGHT: WheelLocation
WHEEL_LOCATION_BACK_LEFT: WheelLocation
WHEEL_LOCATION_BACK_RIGHT: WheelLocation
WHEEL_LOCATION_MIDDLE_LEFT: WheelLocation
WHEEL_LOCATION_MIDDLE_RIGHT: WheelLocation

class WheelPose(_message.Message):
    __slots__ = ("location", "steer", "rotation")
    LOCATION_FIELD_NUMBER: _ClassVar[int]
    STEER_FIELD_NUMBER: _ClassVar[int]
    ROTATION_FIELD_NUMBER: _ClassVar[int]
    location: WheelLocation
    steer: float
    rotation: float
    def __init__(self, location: _Optional[_Union[WheelLocation, str]] = ..., steer: _Optional[float] = ..., rotation: _Optional[float] = ...) -> None: ...

class WheelSet(_message.Message):
    __slots__ = ("id", "wheels")
    ID_FIELD_NUMBER: _ClassVar[int]
    WHEELS_FIELD_NUMBER: _ClassVar[int]
    id: int
    wheels: _containers.RepeatedCompositeFieldContainer[WheelPose]
    def __init__(self, id: _Optional[int] = ..., wheels: _Optional[_Iterable[_Union[WheelPose, _Mapping]]] = ...) -> None: ...

class VehicleWheels(_message.Message):
    __slots__ = ("frame", "elapsed", "vehicles", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    VEHICLES_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    vehicles: _containers.RepeatedCompositeFieldContainer[WheelSet]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., vehicles: _Optional[_Iterable[_Union[WheelSet, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
