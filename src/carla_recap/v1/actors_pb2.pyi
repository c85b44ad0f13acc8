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

class Destroy(_message.Message):
    __slots__ = ("id",)
    ID_FIELD_NUMBER: _ClassVar[int]
    id: int
    def __init__(self, id: _Optional[int] = ...) -> None: ...

class Destroyed(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[Destroy]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[Destroy, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

class Parenting(_message.Message):
    __slots__ = ("id", "parent")
    ID_FIELD_NUMBER: _ClassVar[int]
    PARENT_FIELD_NUMBER: _ClassVar[int]
    id: int
    parent: int
    def __init__(self, id: _Optional[int] = ..., parent: _Optional[int] = ...) -> None: ...

class Parented(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[Parenting]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[Parenting, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

class Transform(_message.Message):
    __slots__ = ("id", "x", "y", "z", "roll", "pitch", "yaw")
    ID_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    ROLL_FIELD_NUMBER: _ClassVar[int]
    PITCH_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    id: int
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    def __init__(self, id: _Optional[int] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., roll: _Optional[float] = ..., pitch: _Optional[float] = ..., yaw: _Optional[float] = ...) -> None: ...

class Transforms(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[Transform]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[Transform, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

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
