from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class SceneLightGroup(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SCENE_LIGHT_GROUP_NONE: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_VEHICLE: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_STREET: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_BUILDING: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_OTHER: _ClassVar[SceneLightGroup]
SCENE_LIGHT_GROUP_NONE: SceneLightGroup
SCENE_LIGHT_GROUP_VEHICLE: SceneLightGroup
SCENE_LIGHT_GROUP_STREET: SceneLightGroup
SCENE_LIGHT_GROUP_BUILDING: SceneLightGroup
SCENE_LIGHT_GROUP_OTHER: SceneLightGroup

class SceneLight(_message.Message):
    __slots__ = ("id", "intensity", "red", "green", "blue", "alpha", "on", "group")
    ID_FIELD_NUMBER: _ClassVar[int]
    INTENSITY_FIELD_NUMBER: _ClassVar[int]
    RED_FIELD_NUMBER: _ClassVar[int]
    GREEN_FIELD_NUMBER: _ClassVar[int]
    BLUE_FIELD_NUMBER: _ClassVar[int]
    ALPHA_FIELD_NUMBER: _ClassVar[int]
    ON_FIELD_NUMBER: _ClassVar[int]
    GROUP_FIELD_NUMBER: _ClassVar[int]
    id: int
    intensity: float
    red: float
    green: float
    blue: float
    alpha: float
    on: bool
    group: SceneLightGroup
    def __init__(self, id: _Optional[int] = ..., intensity: _Optional[float] = ..., red: _Optional[float] = ..., green: _Optional[float] = ..., blue: _Optional[float] = ..., alpha: _Optional[float] = ..., on: _Optional[bool] = ..., group: _Optional[_Union[SceneLightGroup, str]] = ...) -> None: ...

class SceneLights(_message.Message):
    __slots__ = ("frame", "elapsed", "lights", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    LIGHTS_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    lights: _containers.RepeatedCompositeFieldContainer[SceneLight]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., lights: _Optional[_Iterable[_Union[SceneLight, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
