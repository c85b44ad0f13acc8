from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ImuReading(_message.Message):
    __slots__ = ("elapsed", "acceleration_x", "acceleration_y", "acceleration_z", "angular_velocity_x", "angular_velocity_y", "angular_velocity_z", "compass")
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_X_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_Y_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_Z_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_VELOCITY_X_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_VELOCITY_Y_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_VELOCITY_Z_FIELD_NUMBER: _ClassVar[int]
    COMPASS_FIELD_NUMBER: _ClassVar[int]
    elapsed: float
    acceleration_x: float
    acceleration_y: float
    acceleration_z: float
    angular_velocity_x: float
    angular_velocity_y: float
    angular_velocity_z: float
    compass: float
    def __init__(self, elapsed: _Optional[float] = ..., acceleration_x: _Optional[float] = ..., acceleration_y: _Optional[float] = ..., acceleration_z: _Optional[float] = ..., angular_velocity_x: _Optional[float] = ..., angular_velocity_y: _Optional[float] = ..., angular_velocity_z: _Optional[float] = ..., compass: _Optional[float] = ...) -> None: ...

class SpeedReading(_message.Message):
    __slots__ = ("elapsed", "speed", "speed_kmh")
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    SPEED_KMH_FIELD_NUMBER: _ClassVar[int]
    elapsed: float
    speed: float
    speed_kmh: float
    def __init__(self, elapsed: _Optional[float] = ..., speed: _Optional[float] = ..., speed_kmh: _Optional[float] = ...) -> None: ...

class ActorEntry(_message.Message):
    __slots__ = ("id", "type_id", "kind", "role_name", "spawned_at", "destroyed_at")
    ID_FIELD_NUMBER: _ClassVar[int]
    TYPE_ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    ROLE_NAME_FIELD_NUMBER: _ClassVar[int]
    SPAWNED_AT_FIELD_NUMBER: _ClassVar[int]
    DESTROYED_AT_FIELD_NUMBER: _ClassVar[int]
    id: int
    type_id: str
    kind: str
    role_name: str
    spawned_at: float
    destroyed_at: float
    def __init__(self, id: _Optional[int] = ..., type_id: _Optional[str] = ..., kind: _Optional[str] = ..., role_name: _Optional[str] = ..., spawned_at: _Optional[float] = ..., destroyed_at: _Optional[float] = ...) -> None: ...

class ActorTable(_message.Message):
    __slots__ = ("actors",)
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    actors: _containers.RepeatedCompositeFieldContainer[ActorEntry]
    def __init__(self, actors: _Optional[_Iterable[_Union[ActorEntry, _Mapping]]] = ...) -> None: ...
