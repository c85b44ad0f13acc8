from carla_recap.v1 import light_states_pb2 as _light_states_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Followed(_message.Message):
    __slots__ = ("elapsed", "id", "type_id", "x", "y", "z", "roll", "pitch", "yaw", "speed", "speed_kmh", "throttle", "brake", "steer", "hand_brake", "gear", "acceleration", "shown_throttle", "shown_brake")
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    ID_FIELD_NUMBER: _ClassVar[int]
    TYPE_ID_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    Z_FIELD_NUMBER: _ClassVar[int]
    ROLL_FIELD_NUMBER: _ClassVar[int]
    PITCH_FIELD_NUMBER: _ClassVar[int]
    YAW_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    SPEED_KMH_FIELD_NUMBER: _ClassVar[int]
    THROTTLE_FIELD_NUMBER: _ClassVar[int]
    BRAKE_FIELD_NUMBER: _ClassVar[int]
    STEER_FIELD_NUMBER: _ClassVar[int]
    HAND_BRAKE_FIELD_NUMBER: _ClassVar[int]
    GEAR_FIELD_NUMBER: _ClassVar[int]
    ACCELERATION_FIELD_NUMBER: _ClassVar[int]
    SHOWN_THROTTLE_FIELD_NUMBER: _ClassVar[int]
    SHOWN_BRAKE_FIELD_NUMBER: _ClassVar[int]
    elapsed: float
    id: int
    type_id: str
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    speed: float
    speed_kmh: float
    throttle: float
    brake: float
    steer: float
    hand_brake: bool
    gear: int
    acceleration: float
    shown_throttle: float
    shown_brake: float
    def __init__(self, elapsed: _Optional[float] = ..., id: _Optional[int] = ..., type_id: _Optional[str] = ..., x: _Optional[float] = ..., y: _Optional[float] = ..., z: _Optional[float] = ..., roll: _Optional[float] = ..., pitch: _Optional[float] = ..., yaw: _Optional[float] = ..., speed: _Optional[float] = ..., speed_kmh: _Optional[float] = ..., throttle: _Optional[float] = ..., brake: _Optional[float] = ..., steer: _Optional[float] = ..., hand_brake: _Optional[bool] = ..., gear: _Optional[int] = ..., acceleration: _Optional[float] = ..., shown_throttle: _Optional[float] = ..., shown_brake: _Optional[float] = ...) -> None: ...

class ShownLight(_message.Message):
    __slots__ = ("id", "state", "entity", "text")
    ID_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    ENTITY_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    id: int
    state: _light_states_pb2.TrafficLightColor
    entity: str
    text: str
    def __init__(self, id: _Optional[int] = ..., state: _Optional[_Union[_light_states_pb2.TrafficLightColor, str]] = ..., entity: _Optional[str] = ..., text: _Optional[str] = ...) -> None: ...

class ShownLights(_message.Message):
    __slots__ = ("elapsed", "ahead", "lights")
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    AHEAD_FIELD_NUMBER: _ClassVar[int]
    LIGHTS_FIELD_NUMBER: _ClassVar[int]
    elapsed: float
    ahead: ShownLight
    lights: _containers.RepeatedCompositeFieldContainer[ShownLight]
    def __init__(self, elapsed: _Optional[float] = ..., ahead: _Optional[_Union[ShownLight, _Mapping]] = ..., lights: _Optional[_Iterable[_Union[ShownLight, _Mapping]]] = ...) -> None: ...

class ShownState(_message.Message):
    __slots__ = ("name", "text")
    NAME_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    name: str
    text: str
    def __init__(self, name: _Optional[str] = ..., text: _Optional[str] = ...) -> None: ...

class ShownStates(_message.Message):
    __slots__ = ("elapsed", "incidents", "verdicts")
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    INCIDENTS_FIELD_NUMBER: _ClassVar[int]
    VERDICTS_FIELD_NUMBER: _ClassVar[int]
    elapsed: float
    incidents: _containers.RepeatedCompositeFieldContainer[ShownState]
    verdicts: _containers.RepeatedCompositeFieldContainer[ShownState]
    def __init__(self, elapsed: _Optional[float] = ..., incidents: _Optional[_Iterable[_Union[ShownState, _Mapping]]] = ..., verdicts: _Optional[_Iterable[_Union[ShownState, _Mapping]]] = ...) -> None: ...
