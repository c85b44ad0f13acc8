from carla_recap.v1 import actors_pb2 as _actors_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

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
    kind: _actors_pb2.ActorKind
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    uid: int
    type_id: str
    attributes: _containers.RepeatedCompositeFieldContainer[_actors_pb2.Attribute]
    def __init__(self, id: _Optional[int] = ..., kind: _Optional[_Union[_actors_pb2.ActorKind, str]] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., roll: _Optional[float] = ..., pitch: _Optional[float] = ..., yaw: _Optional[float] = ..., uid: _Optional[int] = ..., type_id: _Optional[str] = ..., attributes: _Optional[_Iterable[_Union[_actors_pb2.Attribute, _Mapping]]] = ...) -> None: ...

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

class TransformDouble(_message.Message):
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

class TransformsDouble(_message.Message):
    __slots__ = ("frame", "elapsed", "actors", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ACTORS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    actors: _containers.RepeatedCompositeFieldContainer[TransformDouble]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., actors: _Optional[_Iterable[_Union[TransformDouble, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

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

class BoneDouble(_message.Message):
    __slots__ = ("name", "x", "y", "z", "roll", "pitch", "yaw")
    NAME_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    ROLL_FIELD_NUMBER: _ClassVar[int]
    PITCH_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    name: str
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    def __init__(self, name: _Optional[str] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., roll: _Optional[float] = ..., pitch: _Optional[float] = ..., yaw: _Optional[float] = ...) -> None: ...

class SkeletonDouble(_message.Message):
    __slots__ = ("id", "bones")
    ID_FIELD_NUMBER: _ClassVar[int]
    BONES_FIELD_NUMBER: _ClassVar[int]
    id: int
    bones: _containers.RepeatedCompositeFieldContainer[BoneDouble]
    def __init__(self, id: _Optional[int] = ..., bones: _Optional[_Iterable[_Union[BoneDouble, _Mapping]]] = ...) -> None: ...

class WalkerBonesDouble(_message.Message):
    __slots__ = ("frame", "elapsed", "walkers", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    WALKERS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    walkers: _containers.RepeatedCompositeFieldContainer[SkeletonDouble]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., walkers: _Optional[_Iterable[_Union[SkeletonDouble, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
