"""V2X sensors: vehicles report their motion to each other (CAM), or send messages of clients, over a radio channel.

What is sent in a tick is received in the same tick by all others whose received power suffices. Messages, the conditions for
sending them, and path losses are those of CARLA 0.9.16.
"""

from __future__ import annotations

import struct
import time
from math import acos, degrees, hypot, inf, log10, pi, sqrt
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.scene.lamps import FOG, HIGH_BEAM, LEFT_BLINKER, LOW_BEAM, POSITION, REVERSE, RIGHT_BLINKER
from carla_recap.sensors.noise import Noise, generator
from carla_recap.sensors.position import UPWARDS
from carla_recap.server.sensors.feeds import V2xMessage, axes, flag, number, numbers, receiver, row
from carla_recap.server.sensors.rays import ActorBoxes, solid_actors
from carla_recap.sim.actors.moving import Vehicle
from carla_recap.sim.blueprints import CUSTOM_V2X_SENSOR, V2X_SENSOR

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.sensors.feeds import Feed, FeedContext
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.geometry import Location, Vector
    from carla_recap.util.arrays import Floats


_VERSION: Final = 2
_CAM, _CUSTOM = 2, 0  # message ids
_EPOCH: Final = 1072915200  # s: 2004-01-01 UTC in Unix time, from which V2X counts
_LIGHT_SPEED: Final = 299792458.0  # m/s
_MAST: Final = 0.02  # m: the height of an antenna above the roof
_PERMITTIVITY: Final = 1.02  # of the road, in the two-ray model
_NEAREST: Final = 0.1  # m: the smallest distance between antennas

# power received in dBm, protocol version, message id, station id, text
_CUSTOM_MESSAGE: Final = struct.Struct("<f4x3q100s4x")
_POWER: Final = struct.Struct("<f")
_LONGEST_TEXT: Final = 99  # bytes, besides the NUL
_CAM_FIELDS: Final = {  # by their offsets; all are 8 bytes wide but those below
    name: start + 8 * place
    for start, names in (
        (8, "version message station generation_time station_type latitude longitude semi_major semi_minor"),
        (80, "semi_major_orientation altitude altitude_confidence high_frequency heading heading_confidence speed"),
        (136, "speed_confidence drive_direction length length_confidence width longitudinal longitudinal_confidence"),
        (192, "curvature curvature_confidence"),
        (216, "yaw_rate yaw_rate_confidence"),
        (280, "lateral lateral_confidence"),
        (304, "vertical vertical_confidence"),
        (408, "low_frequency role"),
    )
    for place, name in enumerate(names.split())
}
_CAM_BYTES: Final = {"has_lateral": 272, "has_vertical": 296, "lights": 424}
_CAM_MESSAGE: Final = np.dtype(
    {
        "names": ["power", *_CAM_FIELDS, *_CAM_BYTES],
        "formats": ["<f4", *["<i8"] * len(_CAM_FIELDS), *["u1"] * len(_CAM_BYTES)],
        "offsets": [0, *_CAM_FIELDS.values(), *_CAM_BYTES.values()],
        "itemsize": 464,
    }
)
_CONSTANTS: Final = {  # what is unavailable, and confidences
    "version": _VERSION,
    "message": _CAM,
    "semi_major": 4095,
    "semi_minor": 4095,
    "semi_major_orientation": 3601,
    "altitude_confidence": 15,
    "high_frequency": 1,
    "heading_confidence": 10,
    "speed_confidence": 3,
    "length_confidence": 4,
    "longitudinal_confidence": 102,
    "lateral_confidence": 102,
    "vertical_confidence": 102,
    "has_lateral": 1,
    "has_vertical": 1,
    "curvature": 30001,
    "curvature_confidence": 7,
    "yaw_rate_confidence": 8,
}
_FASTEST: Final = 16382  # cm/s
_MOST_YAW_RATE: Final = 32767  # 0.01 degrees/s: unavailable, or more than can be said
_MOST_ACCELERATION: Final = 161  # 0.1 m/s², likewise
_STATION_TYPES: Final = {"bicycle": 2, "motorcycle": 4, "car": 5, "van": 5, "bus": 6, "truck": 7}
_EMERGENCY_TYPE, _PUBLIC_ROLE, _EMERGENCY_ROLE = 10, 1, 6
# CARLA's light bits, and the bits of exterior lights: low beam, high beam, left and right blinker, reverse, fog, position
_LIGHTS: Final = {
    LOW_BEAM: 0x80,
    HIGH_BEAM: 0x40,
    LEFT_BLINKER: 0x20,
    RIGHT_BLINKER: 0x10,
    REVERSE: 0x04,
    FOG: 0x02,
    POSITION: 0x01,
}

_TURNED, _MOVED, _SPED_UP = 4.0, 4.0, 0.5  # degrees, m and m/s: changes after which a CAM is due
_LOW_FREQUENCY: Final = 0.5  # s, between two CAMs with the role and the lights
_STEADY_CAMS: Final = 3  # CAMs at a shorter interval, before it is the longest again
_ROUNDING: Final = 1e-6  # s

# Standard deviations of shadow fading in dB, by scenario; in sight, and behind another vehicle
_FADING: Final = {"highway": 3.3, "urban": 5.2, "rural": 4.25}
_FADING_BEHIND_VEHICLE: Final = {"highway": 3.8, "urban": 5.3, "rural": 4.55}
_FADING_BEHIND_OTHERS: Final = 6.8


class CamStation:
    """Generates cooperative awareness messages of a sensor's parent, a vehicle."""

    def __init__(self, sensor: Actor) -> None:
        self._sensor = sensor
        self._started = (time.time() - _EPOCH - sensor.episode.clock.elapsed) * 1000
        self._least, self._most = number(sensor, "gen_cam_min"), number(sensor, "gen_cam_max")
        self._interval = self._most
        self._steady = 0
        self._sent_at = self._low_frequency_at = -inf
        self._last: tuple[Vector, Location, float] | None = None
        self._gnss = receiver(sensor)
        attributes = numbers(sensor)
        self._speed_noise = Noise(attributes, (), ["noise_vel_stddev_x"])
        self._heading_noise = Noise(attributes, ["noise_head_bias"], ["noise_head_stddev"])
        self._yaw_rate_noise = Noise(attributes, ["noise_yawrate_bias"], ["noise_yawrate_stddev"])
        self._acceleration_noise = Noise(attributes, (), [f"noise_accel_stddev_{axis}" for axis in "xyz"])

    def generate(self) -> bytes | None:
        """Return a message if one is due."""
        vehicle = self._sensor.parent
        now = self._sensor.episode.clock.elapsed
        if not isinstance(vehicle, Vehicle) or not self._is_due(vehicle, now):
            return None
        self._sent_at = now
        self._last = vehicle.transform.forward(), vehicle.transform.location, vehicle.velocity.length()
        return self._message(vehicle, now)

    def _is_due(self, vehicle: Vehicle, now: float) -> bool:
        elapsed = now - self._sent_at
        if elapsed + _ROUNDING < self._least:
            return False
        if flag(self._sensor, "fixed_rate") or self._last is None:
            return True
        if self._has_changed(vehicle):
            self._interval, self._steady = min(elapsed, self._most), 0
            return True
        if elapsed + _ROUNDING < self._interval:
            return False
        self._steady += 1
        if self._steady >= _STEADY_CAMS:
            self._interval = self._most
        return True

    def _has_changed(self, vehicle: Vehicle) -> bool:
        """Return whether heading, position or speed have changed much since the last message."""
        assert self._last is not None
        forward, location, speed = self._last
        cosine = float(row(forward) @ row(vehicle.transform.forward()))
        return (
            degrees(acos(min(max(cosine, -1.0), 1.0))) > _TURNED
            or vehicle.transform.location.distance(location) > _MOVED
            or abs(vehicle.velocity.length() - speed) > _SPED_UP
        )

    def _message(self, vehicle: Vehicle, now: float) -> bytes:
        message = np.zeros((), _CAM_MESSAGE)
        values = _CONSTANTS | self._basics(vehicle, now) | self._motion(vehicle)
        if now - self._low_frequency_at + _ROUNDING >= _LOW_FREQUENCY:
            self._low_frequency_at = now
            values |= _lights_and_role(vehicle)
        for name, value in values.items():
            message[name] = value
        return message.tobytes()

    def _basics(self, vehicle: Vehicle, now: float) -> dict[str, int]:
        latitude, longitude, altitude = self._gnss.measure(row(vehicle.transform.location)).tolist()
        type = _STATION_TYPES.get(vehicle.attributes.get("base_type", ""), 0)
        return {
            "station": vehicle.id,
            "generation_time": int(self._started + now * 1000) % 65536,
            "station_type": _EMERGENCY_TYPE if vehicle.attributes.get("special_type") == "emergency" else type,
            "latitude": round(latitude * 1e6) * 10,
            "longitude": round(longitude * 1e6) * 10,
            "altitude": round(altitude * 100),
        }

    def _motion(self, vehicle: Vehicle) -> dict[str, int]:
        own, extent = axes(vehicle.transform), vehicle.box.extent
        (heading,) = self._heading_noise.add_to(np.array([vehicle.transform.rotation.yaw + 90])).tolist()
        forward = float(row(vehicle.velocity) @ own[:, 0])
        (speed,) = self._speed_noise.add_to(np.array([forward])).tolist()
        (yaw_rate,) = self._yaw_rate_noise.add_to(np.array([np.radians(vehicle.angular_velocity.z)])).tolist()
        acceleration = self._acceleration_noise.add_to((row(vehicle.acceleration) + UPWARDS) @ own).tolist()
        longitudinal, lateral, vertical = (_limited(10 * value, _MOST_ACCELERATION) for value in acceleration)
        return {
            "heading": round(heading * 10) % 3600,
            "speed": min(round(100 * max(speed, 0.0)), _FASTEST),
            "drive_direction": int(forward < 0),
            "length": round(20 * extent.x),
            "width": round(20 * extent.y),
            "longitudinal": longitudinal,
            "lateral": lateral,
            "vertical": vertical,
            "yaw_rate": _limited(100 * degrees(yaw_rate), _MOST_YAW_RATE),
        }


class CustomStation:
    """Sends the messages of clients, the latest one if there are several in a tick."""

    def __init__(self, sensor: Actor) -> None:
        self._sensor = sensor
        self.text: bytes | None = None

    def generate(self) -> bytes | None:
        """Return the latest message, once."""
        text, self.text = self.text, None
        if text is None or self._sensor.parent is None:
            return None
        return _CUSTOM_MESSAGE.pack(0.0, _VERSION, _CUSTOM, self._sensor.parent.id, text[:_LONGEST_TEXT])


class RadioChannel:
    """The messages that V2X sensors exchange, whether clients listen to them or not."""

    def __init__(self) -> None:
        self._stations: dict[Actor, CamStation | CustomStation] = {}
        self._sent: dict[str, list[V2xMessage]] = {}

    def add(self, sensor: Actor) -> None:
        """Add a sensor, if it is a V2X sensor."""
        if sensor.type_id == V2X_SENSOR:
            self._stations[sensor] = CamStation(sensor)
        elif sensor.type_id == CUSTOM_V2X_SENSOR:
            self._stations[sensor] = CustomStation(sensor)

    def queue(self, sensor: Actor, text: bytes) -> None:
        """Have a sensor send a message in the next tick; one that is no sensor for messages ignores it."""
        if sensor not in self._stations:
            self.add(sensor)
        station = self._stations.get(sensor)
        if isinstance(station, CustomStation):
            station.text = text

    def exchange(self, due: Iterable[Actor]) -> None:
        """Replace the messages of the previous tick by those of the sensors that are due in this one."""
        self._sent = {V2X_SENSOR: [], CUSTOM_V2X_SENSOR: []}
        for sensor in due:
            station = self._stations.get(sensor)
            body = station.generate() if station is not None else None
            if body is not None and sensor.parent is not None:
                self._sent[sensor.type_id].append(V2xMessage(sensor.parent, number(sensor, "transmit_power"), body))

    def stations(self) -> list[Actor]:
        """Return the sensors that exist, in the order of their ids."""
        self._stations = {sensor: station for sensor, station in self._stations.items() if sensor.is_alive}
        return sorted(self._stations, key=lambda sensor: sensor.id)

    def sent(self, type_id: str, receiver: Actor) -> list[V2xMessage]:
        """Return the messages of a kind of sensor from other senders than a receiver: the first of each."""
        first = {message.sender: message for message in reversed(self._sent.get(type_id, []))}
        return sorted((m for m in first.values() if m.sender is not receiver), key=lambda message: message.sender.id)


def v2x(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a V2X sensor: all messages that its parent receives in a tick, in one frame."""
    path_loss = PathLoss(sensor)

    def frames() -> Iterable[bytes]:
        receiver = sensor.parent
        if receiver is None:
            return
        received, gain = [], number(sensor, "combined_antenna_gain")
        messages = context.messages(sensor.type_id, receiver)
        losses = path_loss.losses([message.sender for message in messages], receiver)
        for message, loss in zip(messages, losses, strict=True):
            power = message.power + gain - loss
            if power >= number(sensor, "receiver_sensitivity"):
                received.append(_POWER.pack(power) + message.body[_POWER.size :])
        if received:
            yield b"".join(received)

    return frames


class PathLoss:
    """The loss of power between antennas on the roofs of two actors, in dB, by the model of the receiving sensor."""

    def __init__(self, sensor: Actor) -> None:
        self._sensor = sensor
        self._random = generator(number(sensor, "noise_seed"))
        self._scenario = sensor.attributes.get("scenario", "")
        self._is_geometric = sensor.attributes.get("path_loss_model") == "geometric"
        self._gigahertz = max(number(sensor, "frequency_ghz"), 1e-3)
        self._wavelength = _LIGHT_SPEED / (self._gigahertz * 1e9)

    def losses(self, senders: list[Actor], receiver: Actor) -> list[float]:
        """Return the losses between senders and a receiver; infinite for those that are too far away."""
        end = _antenna(receiver)
        starts = np.array([_antenna(sender) for sender in senders]).reshape(-1, 3)
        distances = np.maximum(np.linalg.norm(starts - end, axis=1), _NEAREST)
        near = np.flatnonzero(distances < number(self._sensor, "filter_distance")).tolist()
        losses = [inf] * len(senders)
        obstacles = self._obstacles([senders[i] for i in near], receiver, starts[near], end) if near else []
        for i, others in zip(near, obstacles, strict=True):
            losses[i] = self._loss(senders[i], receiver, float(distances[i]), others)
        return losses

    def _loss(self, sender: Actor, receiver: Actor, distance: float, obstacles: list[Actor]) -> float:
        start, end = _antenna(sender), _antenna(receiver)
        ground = min(sender.transform.location.z, receiver.transform.location.z)
        state, behind = "", 0.0
        if not all(isinstance(obstacle, Vehicle) for obstacle in obstacles):
            state = "others"
        elif obstacles:
            state, behind = "vehicle", max(self._knife_edge(vehicle, ground, start, end) for vehicle in obstacles)
        if self._is_geometric:
            loss = self._geometric(state, distance, float(start[2] - ground), float(end[2] - ground))
        else:
            loss = self._winner(state, distance)
        return loss + behind + self._fading(state)

    def _obstacles(self, senders: list[Actor], receiver: Actor, starts: Floats, end: Floats) -> list[list[Actor]]:
        """Return the actors in each line of sight."""
        actors = solid_actors(self._sensor.episode.actors.values())
        lengths = np.maximum(np.linalg.norm(starts - end, axis=1), _NEAREST)
        hits = ActorBoxes(actors).pierce(end, (starts - end) / lengths[:, None], float(lengths.max()))
        found: list[list[Actor]] = [[] for _ in senders]
        for ray, box, distance in zip(hits.ray.tolist(), hits.box.tolist(), hits.distance.tolist(), strict=True):
            if distance <= lengths[ray] and actors[box] is not receiver and actors[box] is not senders[ray]:
                found[ray].append(actors[box])
        return found

    def _winner(self, state: str, distance: float) -> float:
        if state == "others":
            return 36.85 + 30 * log10(distance) + 18.9 * log10(self._gigahertz)
        if self._scenario == "highway":
            return 32.4 + 20 * log10(distance) + 20 * log10(self._gigahertz)
        return 38.77 + 16.7 * log10(distance) + 18.2 * log10(self._gigahertz)

    def _geometric(self, state: str, distance: float, height: float, other: float) -> float:
        if state == "others":
            least = max(number(self._sensor, "d_ref"), _NEAREST)
            return self._free_space(least) + 10 * number(self._sensor, "path_loss_exponent") * log10(distance / least)
        return self._free_space(distance) if state == "vehicle" else self._two_ray(distance, height, other)

    def _free_space(self, distance: float) -> float:
        return 20 * log10(4 * pi * distance / self._wavelength)

    def _two_ray(self, distance: float, height: float, other: float) -> float:
        """Return the loss of a direct ray and one that the road reflects."""
        ground = max(sqrt(max(distance**2 - (height - other) ** 2, 0.0)), _NEAREST)
        reflected = sqrt(distance**2 + 4 * height * other)
        sine, cosine = (height + other) / reflected, ground / reflected
        root = sqrt(max(_PERMITTIVITY - cosine**2, 0.0))
        coefficient = (sine - root) / (sine + root)
        phase = 2 * pi / self._wavelength * (distance - reflected)
        sum_of_rays = hypot(1 + coefficient * np.cos(phase), coefficient * np.sin(phase))
        return 20 * log10(4 * pi * ground / self._wavelength / max(sum_of_rays, 1e-9))

    def _knife_edge(self, vehicle: Actor, ground: float, start: Floats, end: Floats) -> float:
        """Return the loss behind a vehicle."""
        x, y = vehicle.transform.location.x, vehicle.transform.location.y
        first, second = (max(hypot(x - point[0], y - point[1]), _NEAREST) for point in (start, end))
        height = _antenna(vehicle)[2] - ground
        v = height * sqrt(2 * (first + second) / (self._wavelength * first * second))
        return 6.9 + 20 * log10(sqrt((v - 0.1) ** 2 + 1) + v - 0.1) if v >= -0.78 else 0.0

    def _fading(self, state: str) -> float:
        deviation = abs(number(self._sensor, "custom_fading_stddev"))
        if flag(self._sensor, "use_etsi_fading"):
            table = _FADING_BEHIND_VEHICLE if state == "vehicle" else _FADING
            deviation = _FADING_BEHIND_OTHERS if state == "others" else table.get(self._scenario, table["highway"])
        return float(self._random.normal(0.0, deviation)) if deviation else 0.0


def message_bytes(message: Any) -> bytes:
    """Return the bytes of a message from a client: a text, or bytes, or as of newer clients the size and bytes."""
    size = None
    if isinstance(message, list) and len(message) > 1 and isinstance(message[0], int):
        size, message = max(message[0], 0), message[1]
    if isinstance(message, str):
        message = message.encode("utf-8", "surrogateescape")
    return message[:size] if isinstance(message, bytes) else b""


def _antenna(actor: Actor) -> Floats:
    """Return the top of the antenna of an actor: a little above its roof."""
    location = actor.transform.location
    return np.array((location.x, location.y, location.z + 2 * actor.box.extent.z + _MAST))


def _limited(value: float, most: int) -> int:
    """Return a number for a CAM, or the one that stands for too large ones."""
    return round(value) if abs(value) < most else most


def _lights_and_role(vehicle: Vehicle) -> dict[str, int]:
    is_emergency = vehicle.attributes.get("special_type") == "emergency"
    is_bus = vehicle.attributes.get("base_type") == "bus"
    return {
        "low_frequency": 1,
        "role": _EMERGENCY_ROLE if is_emergency else _PUBLIC_ROLE if is_bus else 0,
        "lights": sum(exterior for bit, exterior in _LIGHTS.items() if vehicle.light_state & bit),
    }
