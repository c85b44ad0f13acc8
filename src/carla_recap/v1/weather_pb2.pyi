from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

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
