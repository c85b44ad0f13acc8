from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Bone(_message.Message):
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

class Skeleton(_message.Message):
    __slots__ = ("id", "bones")
    ID_FIELD_NUMBER: _ClassVar[int]
    BONES_FIELD_NUMBER: _ClassVar[int]
    id: int
    bones: _containers.RepeatedCompositeFieldContainer[Bone]
    def __init__(self, id: _Optional[int] = ..., bones: _Optional[_Iterable[_Union[Bone, _Mapping]]] = ...) -> None: ...

class WalkerBones(_message.Message):
    __slots__ = ("frame", "elapsed", "walkers", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    WALKERS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    walkers: _containers.RepeatedCompositeFieldContainer[Skeleton]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., walkers: _Optional[_Iterable[_Union[Skeleton, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...

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
