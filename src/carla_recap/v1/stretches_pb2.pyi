from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Stretch(_message.Message):
    __slots__ = ("id", "type_id", "start", "duration", "x", "y", "z")
    ID_FIELD_NUMBER: _ClassVar[int]
    TYPE_ID_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    DURATION_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    id: int
    type_id: str
    start: float
    duration: float
    x: float
    y: float
    z: float
    def __init__(self, id: _Optional[int] = ..., type_id: _Optional[str] = ..., start: _Optional[float] = ..., duration: _Optional[float] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ...) -> None: ...

class Stretches(_message.Message):
    __slots__ = ("frame", "elapsed", "stretches")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    STRETCHES_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    stretches: _containers.RepeatedCompositeFieldContainer[Stretch]
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., stretches: _Optional[_Iterable[_Union[Stretch, _Mapping]]] = ...) -> None: ...
