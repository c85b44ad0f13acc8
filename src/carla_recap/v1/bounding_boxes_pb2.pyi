from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class BoundingBox(_message.Message):
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

class BoundingBoxes(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[BoundingBox]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[BoundingBox, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

class BoundingBoxDouble(_message.Message):
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

class BoundingBoxesDouble(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[BoundingBoxDouble]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[BoundingBoxDouble, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
