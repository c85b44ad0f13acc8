from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Velocity(_message.Message):
    __slots__ = ("id", "x", "y", "z", "angular_x", "angular_y", "angular_z")
    ID_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_X_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_Y_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_Z_FIELD_NUMBER: _ClassVar[int]
    id: int
    x: float
    y: float
    z: float
    angular_x: float
    angular_y: float
    angular_z: float
    def __init__(self, id: _Optional[int] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., angular_x: _Optional[float] = ..., angular_y: _Optional[float] = ..., angular_z: _Optional[float] = ...) -> None: ...

class Velocities(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[Velocity]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[Velocity, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

class VelocityDouble(_message.Message):
    __slots__ = ("id", "x", "y", "z", "angular_x", "angular_y", "angular_z")
    ID_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_X_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_Y_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_Z_FIELD_NUMBER: _ClassVar[int]
    id: int
    x: float
    y: float
    z: float
    angular_x: float
    angular_y: float
    angular_z: float
    def __init__(self, id: _Optional[int] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., angular_x: _Optional[float] = ..., angular_y: _Optional[float] = ..., angular_z: _Optional[float] = ...) -> None: ...

class VelocitiesDouble(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[VelocityDouble]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[VelocityDouble, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
