from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class TriggerVolume(_message.Message):
    __slots__ = ("id", "x", "y", "z", "extent_x", "extent_y", "extent_z")
    ID_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    EXTENT_X_FIELD_NUMBER: _ClassVar[int]
    EXTENT_Y_FIELD_NUMBER: _ClassVar[int]
    EXTENT_Z_FIELD_NUMBER: _ClassVar[int]
    id: int
    x: float
    y: float
    z: float
    extent_x: float
    extent_y: float
    extent_z: float
    def __init__(self, id: _Optional[int] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., extent_x: _Optional[float] = ..., extent_y: _Optional[float] = ..., extent_z: _Optional[float] = ...) -> None: ...

class TriggerVolumes(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[TriggerVolume]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[TriggerVolume, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

class TriggerVolumeDouble(_message.Message):
    __slots__ = ("id", "x", "y", "z", "extent_x", "extent_y", "extent_z")
    ID_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    EXTENT_X_FIELD_NUMBER: _ClassVar[int]
    EXTENT_Y_FIELD_NUMBER: _ClassVar[int]
    EXTENT_Z_FIELD_NUMBER: _ClassVar[int]
    id: int
    x: float
    y: float
    z: float
    extent_x: float
    extent_y: float
    extent_z: float
    def __init__(self, id: _Optional[int] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., extent_x: _Optional[float] = ..., extent_y: _Optional[float] = ..., extent_z: _Optional[float] = ...) -> None: ...

class TriggerVolumesDouble(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[TriggerVolumeDouble]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[TriggerVolumeDouble, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
