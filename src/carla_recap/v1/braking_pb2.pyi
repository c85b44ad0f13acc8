from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class BrakingInterval(_message.Message):
    __slots__ = ("id", "start", "stop", "x", "y", "z", "speed")
    ID_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    STOP_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    id: int
    start: float
    stop: float
    x: float
    y: float
    z: float
    speed: float
    def __init__(self, id: _Optional[int] = ..., start: _Optional[float] = ..., stop: _Optional[float] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., speed: _Optional[float] = ...) -> None: ...

class BrakingIntervals(_message.Message):
    __slots__ = ("frame", "elapsed", "intervals")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    INTERVALS_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    intervals: _containers.RepeatedCompositeFieldContainer[BrakingInterval]
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., intervals: _Optional[_Iterable[_Union[BrakingInterval, _Mapping]]] = ...) -> None: ...
