"""V2X sensors: what is sent when, what is received, and how the official client reads it."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from math import log10
from typing import TYPE_CHECKING, Any

import carla
import numpy as np
import pytest

from carla_recap.server.sensors.v2x import PathLoss, message_bytes
from carla_recap.sim.geometry import Vector
from tests.server.client import Data, place
from tests.server.client import sensor as sensor_on
from tests.server.listening import HERE, Listener, sensor, served, vehicle
from tests.sim.flat import at
from tests.waiting import wait_until

if TYPE_CHECKING:
    from carla_recap.server.host import Host
    from carla_recap.sim.episode import Actor

CAM = np.dtype(
    {
        "names": ["power", "station", "generation_time", "heading", "speed", "vertical", "low_frequency"],
        "formats": ["<f4", "<i8", "<i8", "<i8", "<i8", "<i8", "<i8"],
        "offsets": [0, 24, 32, 112, 128, 304, 408],
        "itemsize": 464,
    }
)


def cam_sensor(host: Host, parent: Actor, **attributes: str) -> Listener:
    return sensor(host, "other.v2x", parent, HERE, use_etsi_fading="false", **attributes)


def cams(listener: Listener) -> list[tuple[int, Any]]:
    """Return the frames and messages since the last call."""
    return [(header[1], message) for header, payload in listener.take() for message in np.frombuffer(payload, CAM)]


def test_vehicles_hear_each_other_and_not_themselves() -> None:
    host = served()
    one, other = vehicle(host, yaw=90.0), vehicle(host, 100.0)
    listeners = [cam_sensor(host, car) for car in (one, other)]
    frame = host.tick()
    ((_, first),), ((_, second),) = (cams(listener) for listener in listeners)
    assert (first["station"], second["station"]) == (other.id, one.id)
    assert (first["heading"], second["heading"]) == (900, 1800)  # clockwise from north
    assert (first["speed"], first["vertical"], first["low_frequency"]) == (0, 98, 1)
    assert frame == host.frame
    assert first["power"] == pytest.approx(21.5 + 10 - (32.4 + 20 * log10(100) + 20 * log10(5.9)), abs=1e-3)


def test_messages_have_the_time_since_2004_in_ms_of_which_16_bits_are_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "time", lambda: datetime(2004, 1, 1, 0, 1, 5, tzinfo=UTC).timestamp())
    host = served()
    for _ in range(5):
        host.tick()
    host.world.spawn("sensor.other.v2x", HERE, parent=vehicle(host, 20.0))
    receiver = cam_sensor(host, vehicle(host))
    for _ in range(21):
        host.tick()
    assert [message["generation_time"] for _, message in cams(receiver)] == pytest.approx([65_000, 66_000 - 65_536], abs=1)


def times(speed: float, steer: float = 0.0, **attributes: str) -> list[int]:
    """Return the ticks of 50 ms after the first one in which a car sends."""
    host = served()
    car = vehicle(host, 30.0)
    host.world.spawn("sensor.other.v2x", HERE, parent=car, **attributes)
    receiver = cam_sensor(host, vehicle(host, 0.0, 20.0))
    first = host.tick()
    car.set_simulate_physics(False)
    for tick in range(1, 41):
        car.transform = at(30.0 + speed * 0.05 * tick, yaw=steer * tick)
        car.set_target_velocity(Vector(speed))
        host.tick()
    return [frame - first for frame, _ in cams(receiver)][1:]


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        ({"speed": 0.0}, [20, 40]),  # every second
        ({"speed": 16.0}, [2, 4, 6, 8, 14, 20]),  # for its speed, three more after the same time, then every 4 m
        ({"speed": 0.0, "steer": 1.1}, [4, 8, 12]),  # every 4 degrees
        ({"speed": 0.0, "fixed_rate": "true", "gen_cam_min": "0.25"}, [5, 10, 15]),
        ({"speed": 16.0, "sensor_tick": "0.5"}, [10, 20, 30, 40]),
    ],
)
def test_a_vehicle_sends_when_it_has_moved_or_after_some_time(motion: dict[str, Any], expected: list[int]) -> None:
    assert times(**motion)[: len(expected)] == expected


@pytest.mark.parametrize(
    ("distance", "attributes", "is_received"),
    [
        (400.0, {}, True),
        (501.0, {}, False),
        (501.0, {"filter_distance": "600"}, True),
        (400.0, {"receiver_sensitivity": "-60"}, False),
        (400.0, {"receiver_sensitivity": "-60", "combined_antenna_gain": "25"}, True),
    ],
)
def test_only_what_is_strong_enough_is_received(distance: float, attributes: dict[str, str], is_received: bool) -> None:
    host = served()
    receiver = cam_sensor(host, vehicle(host), **attributes)
    cam_sensor(host, vehicle(host, distance))
    host.tick()
    assert bool(cams(receiver)) is is_received


class Radio:
    """A receiver, and a vehicle some m ahead of it that sends."""

    def __init__(self, distance: float = 100.0, fading: str = "false", **attributes: str) -> None:
        self.host = served()
        self.one, self.other = vehicle(self.host), vehicle(self.host, distance)
        attributes |= {"use_etsi_fading": fading}
        receiver = self.host.world.spawn("sensor.other.v2x", HERE, parent=self.one, **attributes)
        self.path_loss = PathLoss(receiver)

    def loss(self) -> float:
        """Return the loss on the way, in dB."""
        return self.path_loss.losses([self.other], self.one)[0]


@pytest.mark.parametrize(
    ("distance", "scenario", "expected"),
    [(10.0, "highway", 67.817), (400.0, "highway", 99.858), (50.0, "urban", 81.172), (200.0, "rural", 91.227)],
)
def test_path_losses_in_sight(distance: float, scenario: str, expected: float) -> None:
    assert Radio(distance, scenario=scenario, path_loss_model="winner").loss() == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(("distance", "expected"), [(10.0, 67.620), (50.0, 81.492), (100.0, 91.392), (400.0, 98.182)])
def test_two_rays_interfere(distance: float, expected: float) -> None:
    found = Radio(path_loss_model="geometric").path_loss._two_ray(distance, 1.5, 1.5)
    assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(("model", "expected"), [("winner", 32.4 + 20 * log10(5.9)), ("geometric", 47.865)])
def test_a_truck_in_between_costs_power(model: str, expected: float) -> None:
    radio = Radio(path_loss_model=model)
    free = radio.loss()
    truck = radio.host.world.spawn("vehicle.carlamotors.firetruck", at(40.0))
    behind = radio.loss()
    assert 25.0 < behind - (expected + 40) < 40.0
    assert behind > free + 20
    truck.transform = at(40.0, 30.0)
    assert radio.loss() == pytest.approx(free)


def test_a_wall_of_props_costs_power() -> None:
    radio = Radio()
    radio.host.world.spawn("static.prop.kiosk_01", at(50.0))
    assert radio.loss() == pytest.approx(111.419, abs=1e-3)


def test_fading_is_the_same_for_a_seed() -> None:
    radios = [Radio(fading="true", noise_seed=seed) for seed in ("3", "3", "4")]
    losses = [[radio.loss() for _ in range(300)] for radio in radios]
    assert losses[0] == losses[1] != losses[2]
    assert np.std(losses[0]) == pytest.approx(3.3, rel=0.2)
    assert np.mean(losses[0]) == pytest.approx(87.817, abs=0.6)


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        ("hallo", b"hallo"),
        (b"\x00\xff", b"\x00\xff"),
        ([2, b"abc"], b"ab"),
        ([3, "abcd"], b"abc"),
        (None, b""),
        (7, b""),
        ([2, [2, b"ab"]], b""),
    ],
)
def test_messages_of_clients_come_in_several_forms(message: Any, expected: bytes) -> None:
    assert message_bytes(message) == expected


# --- the official client ---------------------------------------------------------------------------------


def carrier(world: carla.World, name: str, x: float = 0.0) -> carla.Actor:
    return place(world, name, carla.Transform(carla.Location(3000.0 + x, 3000.0, 0.5)))


def received(world: carla.World, data: Data, act: Any = lambda: None) -> Any:
    def has_come() -> bool:
        if data.empty():
            act()
            world.tick()
        return not data.empty()

    wait_until(has_come, pause=0.05)
    return data.get()


def test_the_client_reads_cams(world: carla.World) -> None:
    bus, car = carrier(world, "vehicle.mitsubishi.fusorosa", 30.0), carrier(world, "vehicle.lincoln.mkz_2017")
    _, listening = (sensor_on(world, "other.v2x", parent, fixed_rate="true") for parent in (bus, car))
    bus.set_light_state(carla.VehicleLightState(carla.VehicleLightState.LowBeam))
    bus.enable_constant_velocity(carla.Vector3D(x=0.5))
    event = received(world, Data(listening))
    assert (type(event), event.get_message_count(), len(event)) == (carla.CAMEvent, 1, 1)
    (message,) = event
    found = message.get()
    assert message.power == pytest.approx(-50, abs=25)
    assert found["Message"]["Header"]["Station ID"] == bus.id
    parameters = found["Message"]["Message"]["CAM Parameters"]
    basic = parameters["Basic Container"]
    motion = parameters["High Frequency Container"]["Basic Vehicle Container High Frequency"]
    low = parameters["Low Frequency Container"]["Basic Vehicle Low Frequency"]
    there = world.get_map().transform_to_geolocation(bus.get_location())
    assert basic["Station Type"] == "Bus"
    assert basic["Reference Position"]["Latitude"] == pytest.approx(there.latitude * 1e7, abs=10)
    assert basic["Reference Position"]["Longitude"] == pytest.approx(there.longitude * 1e7, abs=10)
    assert (motion["Heading"]["Value"], motion["Speed"]["Value"]) == (900, 50)
    assert (motion["Vehicle Length"]["Value"], motion["Vehicle Width"]) == (103, 39)
    assert motion["Vertical Acceleration"]["Value"] == 98
    assert (low["Vehicle Role"], low["Exterior Light"]) == ("Public Transport", 128)


def test_the_client_sends_and_reads_messages_of_its_own(world: carla.World) -> None:
    cars = [carrier(world, "vehicle.audi.tt", x) for x in (0.0, 30.0, 900.0)]
    radios = [sensor_on(world, "other.v2x_custom", car) for car in cars]
    own, near, far = map(Data, radios)
    event = received(world, near, lambda: radios[0].send("ice on the road"))
    assert (type(event), event.get_message_count()) == (carla.CustomV2XEvent, 1)
    (message,) = event
    assert message.get()["Message"]["Message"] == "ice on the road"
    assert message.get()["Message"]["Header"]["Station ID"] == cars[0].id
    radios[0].send("x" * 300)
    texts = [received(world, near)[0].get()["Message"]["Message"]]

    def is_last() -> bool:
        while not near.empty():
            texts.append(near.get()[0].get()["Message"]["Message"])
        return texts[-1] == "x" * 99

    wait_until(is_last)
    assert own.empty()
    assert far.empty()
