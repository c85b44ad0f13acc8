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

class SceneLightGroup(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SCENE_LIGHT_GROUP_NONE: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_VEHICLE: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_STREET: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_BUILDING: _ClassVar[SceneLightGroup]
    SCENE_LIGHT_GROUP_OTHER: _ClassVar[SceneLightGroup]
TRAFFIC_LIGHT_COLOR_RED: TrafficLightColor
TRAFFIC_LIGHT_COLOR_YELLOW: TrafficLightColor
TRAFFIC_LIGHT_COLOR_GREEN: TrafficLightColor
TRAFFIC_LIGHT_COLOR_OFF: TrafficLightColor
TRAFFIC_LIGHT_COLOR_UNKNOWN: TrafficLightColor
SCENE_LIGHT_GROUP_NONE: SceneLightGroup
SCENE_LIGHT_GROUP_VEHICLE: SceneLightGroup
SCENE_LIGHT_GROUP_STREET: SceneLightGroup
SCENE_LIGHT_GROUP_BUILDING: SceneLightGroup
SCENE_LIGHT_GROUP_OTHER: SceneLightGroup

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

class WeatherState(_message.Message):
    __slots__ = ("cloudiness", "precipitation", "precipitation_deposits", "wind_intensity", "sun_azimuth_angle", "sun_altitude_angle", "fog_density", "fog_distance", "fog_falloff", "wetness", "scattering_intensity", "mie_scattering_scale", "rayleigh_scattering_scale", "dust_storm")
    CLOUDINESS_FIELD_NUMBER: _ClassVar[int]
    PRECIPITATION_FIELD_NUMBER: _ClassVar[int]
    PRECIPITATION_DEPOSITS_FIELD_NUMBER: _ClassVar[int]
    WIND_INTENSITY_FIELD_NUMBER: _ClassVar[int]
    SUN_AZIMUTH_ANGLE_FIELD_NUMBER: _ClassVar[int]
    SUN_ALTITUDE_ANGLE_FIELD_NUMBER: _ClassVar[int]
    FOG_DENSITY_FIELD_NUMBER: _ClassVar[int]
    FOG_DISTANCE_FIELD_NUMBER: _ClassVar[int]
    FOG_FALLOFF_FIELD_NUMBER: _ClassVar[int]
    WETNESS_FIELD_NUMBER: _ClassVar[int]
    SCATTERING_INTENSITY_FIELD_NUMBER: _ClassVar[int]
    MIE_SCATTERING_SCALE_FIELD_NUMBER: _ClassVar[int]
    RAYLEIGH_SCATTERING_SCALE_FIELD_NUMBER: _ClassVar[int]
    DUST_STORM_FIELD_NUMBER: _ClassVar[int]
    cloudiness: float
    precipitation: float
    precipitation_deposits: float
    wind_intensity: float
    sun_azimuth_angle: float
    sun_altitude_angle: float
    fog_density: float
    fog_distance: float
    fog_falloff: float
    wetness: float
    scattering_intensity: float
    mie_scattering_scale: float
    rayleigh_scattering_scale: float
    dust_storm: float
    def __init__(self, cloudiness: _Optional[float] = ..., precipitation: _Optional[float] = ..., precipitation_deposits: _Optional[float] = ..., wind_intensity: _Optional[float] = ..., sun_azimuth_angle: _Optional[float] = ..., sun_altitude_angle: _Optional[float] = ..., fog_density: _Optional[float] = ..., fog_distance: _Optional[float] = ..., fog_falloff: _Optional[float] = ..., wetness: _Optional[float] = ..., scattering_intensity: _Optional[float] = ..., mie_scattering_scale: _Optional[float] = ..., rayleigh_scattering_scale: _Optional[float] = ..., dust_storm: _Optional[float] = ...) -> None: ...

class Weather(_message.Message):
    __slots__ = ("frame", "elapsed", "weather", "raw")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_FIELD_NUMBER: _ClassVar[int]
    WEATHER_FIELD_NUMBER: _ClassVar[int]
    RAW_FIELD_NUMBER: _ClassVar[int]
    frame: int
    elapsed: float
    weather: _containers.RepeatedCompositeFieldContainer[WeatherState]
    raw: bytes
    def __init__(self, frame: _Optional[int] = ..., elapsed: _Optional[float] = ..., weather: _Optional[_Iterable[_Union[WeatherState, _Mapping]]] = ..., raw: _Optional[bytes] = ...) -> None: ...
