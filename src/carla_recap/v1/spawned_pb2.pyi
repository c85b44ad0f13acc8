from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ActorKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ACTOR_KIND_OTHER: _ClassVar[ActorKind]
    ACTOR_KIND_VEHICLE: _ClassVar[ActorKind]
    ACTOR_KIND_WALKER: _ClassVar[ActorKind]
    ACTOR_KIND_TRAFFIC_LIGHT: _ClassVar[ActorKind]
    ACTOR_KIND_TRAFFIC_SIGN: _ClassVar[ActorKind]
    ACTOR_KIND_SENSOR: _ClassVar[ActorKind]
    ACTOR_KIND_INVALID: _ClassVar[ActorKind]
ACTOR_KIND_OTHER: ActorKind
ACTOR_KIND_VEHICLE: ActorKind
ACTOR_KIND_WALKER: ActorKind
ACTOR_KIND_TRAFFIC_LIGHT: ActorKind
ACTOR_KIND_TRAFFIC_SIGN: ActorKind
ACTOR_KIND_SENSOR: ActorKind
ACTOR_KIND_INVALID: ActorKind

class Attribute(_message.Message):
    __slots__ = ("type", "key", "value")
    TYPE_FIELD_NUMBER: _ClassVar[int]
    KEY_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    type: int
    key: str
    value: str
    def __init__(self, type: _Optional[int] = ..., key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...

class Spawn(_message.Message):
    __slots__ = ("id", "kind", "x", "y", "z", "roll", "pitch", "yaw", "uid", "type_id", "attributes")
    ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    ROLL_FIELD_NUMBER: _ClassVar[int]
    PITCH_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    UID_FIELD_NUMBER: _ClassVar[int]
    TYPE_ID_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    id: int
    kind: ActorKind
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    uid: int
    type_id: str
    attributes: _containers.RepeatedCompositeFieldContainer[Attribute]
    def __init__(self, id: _Optional[int] = ..., kind: _Optional[_Union[ActorKind, str]] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., roll: _Optional[float] = ..., pitch: _Optional[float] = ..., yaw: _Optional[float] = ..., uid: _Optional[int] = ..., type_id: _Optional[str] = ..., attributes: _Optional[_Iterable[_Union[Attribute, _Mapping]]] = ...) -> None: ...

class Spawned(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[Spawn]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[Spawn, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

class SpawnDouble(_message.Message):
    __slots__ = ("id", "kind", "x", "y", "z", "roll", "pitch", "yaw", "uid", "type_id", "attributes")
    ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    ROLL_FIELD_NUMBER: _ClassVar[int]
    PITCH_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    UID_FIELD_NUMBER: _ClassVar[int]
    TYPE_ID_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    id: int
    kind: ActorKind
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    uid: int
    type_id: str
    attributes: _containers.RepeatedCompositeFieldContainer[Attribute]
    def __init__(self, id: _Optional[int] = ..., kind: _Optional[_Union[ActorKind, str]] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., roll: _Optional[float] = ..., pitch: _Optional[float] = ..., yaw: _Optional[float] = ..., uid: _Optional[int] = ..., type_id: _Optional[str] = ..., attributes: _Optional[_Iterable[_Union[Attribute, _Mapping]]] = ...) -> None: ...

class SpawnedDouble(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[SpawnDouble]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[SpawnDouble, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
