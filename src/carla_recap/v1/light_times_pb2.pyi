from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class TrafficLightTime(_message.Message):
    __slots__ = ("id", "green", "yellow", "red")
    ID_FIELD_NUMBER: _ClassVar[int]
    GREEN_FIELD_NUMBER: _ClassVar[int]
    YELLOW_FIELD_NUMBER: _ClassVar[int]
    RED_FIELD_NUMBER: _ClassVar[int]
    id: int
    green: float
    yellow: float
    red: float
    def __init__(self, id: _Optional[int] = ..., green: _Optional[float] = ..., yellow: _Optional[float] = ..., red: _Optional[float] = ...) -> None: ...

class TrafficLightTimes(_message.Message):
    __slots__ = ("frame", "elapsed", "lights", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    LIGHTS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    lights: _containers.RepeatedCompositeFieldContainer[TrafficLightTime]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., lights: _Optional[_Iterable[_Union[TrafficLightTime, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
