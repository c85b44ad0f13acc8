from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class VehicleLight(_message.Message):
    __slots__ = ("id", "flags")
    ID_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    id: int
    flags: int
    def __init__(self, id: _Optional[int] = ..., flags: _Optional[int] = ...) -> None: ...

class VehicleLights(_message.Message):
    __slots__ = ("frame", "elapsed", "vehicles", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    VEHICLES_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    vehicles: _containers.RepeatedCompositeFieldContainer[VehicleLight]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., vehicles: _Optional[_Iterable[_Union[VehicleLight, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
