from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class WalkerControl(_message.Message):
    __slots__ = ("id", "speed")
    ID_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    id: int
    speed: float
    def __init__(self, id: _Optional[int] = ..., speed: _Optional[float] = ...) -> None: ...

class WalkerControls(_message.Message):
    __slots__ = ("frame", "elapsed", "walkers", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    WALKERS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    walkers: _containers.RepeatedCompositeFieldContainer[WalkerControl]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., walkers: _Optional[_Iterable[_Union[WalkerControl, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
