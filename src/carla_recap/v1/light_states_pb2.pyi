from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class TrafficLightColor(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TRAFFIC_LIGHT_COLOR_RED: _ClassVar[TrafficLightColor]
    TRAFFIC_LIGHT_COLOR_YELLOW: _ClassVar[TrafficLightColor]
    TRAFFIC_LIGHT_COLOR_GREEN: _ClassVar[TrafficLightColor]
    TRAFFIC_LIGHT_COLOR_OFF: _ClassVar[TrafficLightColor]
    TRAFFIC_LIGHT_COLOR_UNKNOWN: _ClassVar[TrafficLightColor]
TRAFFIC_LIGHT_COLOR_RED: TrafficLightColor
TRAFFIC_LIGHT_COLOR_YELLOW: TrafficLightColor
TRAFFIC_LIGHT_COLOR_GREEN: TrafficLightColor
TRAFFIC_LIGHT_COLOR_OFF: TrafficLightColor
TRAFFIC_LIGHT_COLOR_UNKNOWN: TrafficLightColor

class TrafficLightState(_message.Message):
    __slots__ = ("id", "frozen", "elapsed", "state")
    ID_FIELD_NUMBER: _ClassVar[int]
    FROZEN_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    id: int
    frozen: bool
    elapsed: float
    state: TrafficLightColor
    def __init__(self, id: _Optional[int] = ..., frozen: _Optional[bool] = ..., elapsed: _Optional[float] = ..., state: _Optional[_Union[TrafficLightColor, str]] = ...) -> None: ...

class TrafficLightStates(_message.Message):
    __slots__ = ("frame", "elapsed", "lights", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    LIGHTS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    lights: _containers.RepeatedCompositeFieldContainer[TrafficLightState]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., lights: _Optional[_Iterable[_Union[TrafficLightState, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
