from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

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
