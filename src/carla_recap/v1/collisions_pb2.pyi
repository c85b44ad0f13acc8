from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Collision(_message.Message):
    __slots__ = ("id", "actor1", "actor2", "hero1", "hero2")
    ID_FIELD_NUMBER: _ClassVar[int]
    ACTOR1_FIELD_NUMBER: _ClassVar[int]
    ACTOR2_FIELD_NUMBER: _ClassVar[int]
    HERO1_FIELD_NUMBER: _ClassVar[int]
    HERO2_FIELD_NUMBER: _ClassVar[int]
    id: int
    actor1: int
    actor2: int
    hero1: bool
    hero2: bool
    def __init__(self, id: _Optional[int] = ..., actor1: _Optional[int] = ..., actor2: _Optional[int] = ..., hero1: _Optional[bool] = ..., hero2: _Optional[bool] = ...) -> None: ...

class Collisions(_message.Message):
    __slots__ = ("frame", "elapsed", "collisions", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    COLLISIONS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    collisions: _containers.RepeatedCompositeFieldContainer[Collision]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., collisions: _Optional[_Iterable[_Union[Collision, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
