from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DoorLocation(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DOOR_LOCATION_FRONT_LEFT: _ClassVar[DoorLocation]
    DOOR_LOCATION_FRONT_RIGHT: _ClassVar[DoorLocation]
    DOOR_LOCATION_REAR_LEFT: _ClassVar[DoorLocation]
    DOOR_LOCATION_REAR_RIGHT: _ClassVar[DoorLocation]
    DOOR_LOCATION_HOOD: _ClassVar[DoorLocation]
    DOOR_LOCATION_TRUNK: _ClassVar[DoorLocation]
    DOOR_LOCATION_ALL: _ClassVar[DoorLocation]
DOOR_LOCATION_FRONT_LEFT: DoorLocation
DOOR_LOCATION_FRONT_RIGHT: DoorLocation
DOOR_LOCATION_REAR_LEFT: DoorLocation
DOOR_LOCATION_REAR_RIGHT: DoorLocation
DOOR_LOCATION_HOOD: DoorLocation
DOOR_LOCATION_TRUNK: DoorLocation
DOOR_LOCATION_ALL: DoorLocation

class Door(_message.Message):
    __slots__ = ("id", "door", "open")
    ID_FIELD_NUMBER: _ClassVar[int]
    DOOR_FIELD_NUMBER: _ClassVar[int]
    OPEN_FIELD_NUMBER: _ClassVar[int]
    id: int
    door: DoorLocation
    open: bool
    def __init__(self, id: _Optional[int] = ..., door: _Optional[_Union[DoorLocation, str]] = ..., open: _Optional[bool] = ...) -> None: ...

class VehicleDoors(_message.Message):
    __slots__ = ("frame", "elapsed", "doors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    DOORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    doors: _containers.RepeatedCompositeFieldContainer[Door]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., doors: _Optional[_Iterable[_Union[Door, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
