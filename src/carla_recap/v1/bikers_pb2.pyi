from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Biker(_message.Message):
    __slots__ = ("id", "speed", "engine_rpm_ratio")
    ID_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    ENGINE_RPM_RATIO_FIELD_NUMBER: _ClassVar[int]
    id: int
    speed: float
    engine_rpm_ratio: float
    def __init__(self, id: _Optional[int] = ..., speed: _Optional[float] = ..., engine_rpm_ratio: _Optional[float] = ...) -> None: ...

class Bikers(_message.Message):
    __slots__ = ("frame", "elapsed", "bikers", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    BIKERS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    bikers: _containers.RepeatedCompositeFieldContainer[Biker]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., bikers: _Optional[_Iterable[_Union[Biker, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
