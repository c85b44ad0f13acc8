from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class VehicleControl(_message.Message):
    __slots__ = ("id", "steer", "throttle", "brake", "hand_brake", "gear")
    ID_FIELD_NUMBER: _ClassVar[int]
    STEER_FIELD_NUMBER: _ClassVar[int]
    THROTTLE_FIELD_NUMBER: _ClassVar[int]
    BRAKE_FIELD_NUMBER: _ClassVar[int]
    HAND_BRAKE_FIELD_NUMBER: _ClassVar[int]
    GEAR_FIELD_NUMBER: _ClassVar[int]
    id: int
    steer: float
    throttle: float
    brake: float
    hand_brake: bool
    gear: int
    def __init__(self, id: _Optional[int] = ..., steer: _Optional[float] = ..., throttle: _Optional[float] = ..., brake: _Optional[float] = ..., hand_brake: _Optional[bool] = ..., gear: _Optional[int] = ...) -> None: ...

class VehicleControls(_message.Message):
    __slots__ = ("frame", "elapsed", "vehicles", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    VEHICLES_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    vehicles: _containers.RepeatedCompositeFieldContainer[VehicleControl]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., vehicles: _Optional[_Iterable[_Union[VehicleControl, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
