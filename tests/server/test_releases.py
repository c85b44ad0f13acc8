"""The releases of CARLA's client: their rows in the table, which one a client is of, and clients in their environments."""

from __future__ import annotations

import json
import re
import socket
import struct
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from carla_recap import open_recording
from carla_recap.cli.options import RELEASES as CHOICES
from carla_recap.server import running
from carla_recap.server.protocol import RELEASES, Release
from carla_recap.server.protocol.chaos import ChaosControl
from carla_recap.server.protocol.clients import release_of
from carla_recap.server.rpc.codec import decoder, encoder
from carla_recap.sim.actors.moving import Vehicle
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.physics.physics_control import PhysicsControl
from tests.samples import ROOT
from tests.server.client import connect, free_port, spawn
from tests.server.inside import Inside
from tests.waiting import PATIENCE

SERVER = Path(__file__).parent
SAME = {
    "batches": ["batches_spawn_and_destroy_actors"],
    "navmesh": ["walkers_walk_on_sidewalks_and_crossings"],
    "sensors": ["each_frame_comes_to_queues_of_several_sensors_on_several_vehicles", "synchronous_mode"],
    "traffic_manager": ["episodes_begin_while_it_lives[synchronous-4]"],
    "vehicles": [
        *("a_car_comes_to_the_speed_that_it_is_told[8.0]", "the_road_tells_the_car_its_limit_and_its_light"),
        "the_physics_control_of_every_blueprint_comes_back_as_it_was_sent",
    ],
    "world": [
        *("places_are_projected", "the_map_has_lights_and_signs_by_itself", "settings_are_reset_on_request"),
        *("a_group_begins_again", "lights_are_found_from_the_map_and_back", "a_trigger_volume_is_where_one_stops"),
    ],
}
"""Tests that are run with each client: what they need is in all releases."""
BY_NAME = {release.name: release for release in RELEASES}
OTHERS = ("0.9.15", "0.10.0")
"""The releases whose clients are run beside that of 0.9.16, which all other tests of the server have."""
CAR, PLACE = "vehicle.lincoln.mkz_2020", [[500.0, 500.0, 0.5], [0.0, 0.0, 0.0]]
DESCRIPTION = [0, CAR, []]


def python_of(release: str) -> str:
    """Return the interpreter of an environment with a client."""
    python = ROOT / "build" / "clients" / release.replace(".", "-") / "bin" / "python"
    if not python.exists():
        pytest.skip(f"CARLA's client {release} is not installed: `make clients` does that")
    return str(python)


def output_of(release: str, *arguments: object) -> str:
    command = [python_of(release), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert not done.returncode, done.stdout + done.stderr
    return done.stdout


# --- real clients ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("release", OTHERS)
def test_what_is_in_all_releases_is_the_same_with_a_client(release: str) -> None:
    code = "import sys; sys.path.append(sys.argv.pop(1)); import pytest; sys.exit(pytest.main())"
    tests = [f"{SERVER}/test_{file}.py::test_{name}" for file, names in SAME.items() for name in names]
    packages = Path(pytest.__file__).parents[1]  # behind those of the client
    output_of(release, "-c", code, packages, "-qx", "-p", "no:cacheprovider", *tests)


@pytest.mark.parametrize("release", OTHERS)
def test_the_sample_scripts_run_with_a_client(port: int, recordings: Path, release: str) -> None:
    name, samples = f"{release}.log", ROOT / "samples"
    connect(port).reload_world()  # without the actors of a replay that has ended meanwhile

    def output(script: str, *arguments: object) -> str:
        return output_of(release, samples / f"{script}.py", f"--port={port}", f"-f={name}", *arguments)

    assert "Stopped recording, destroyed 3" in output("start_recording", "-n=3", "-t=2", f"--tm-port={free_port()}")
    created = re.findall(r"Create \d+: (vehicle\.\S+)", output("show_recorder_file_info"))
    assert len(created) == 3
    assert set(created) <= {blueprint.id for blueprint in BY_NAME[release].blueprints(standard_library())}
    assert "Duration" in output("show_recorder_collisions", "-t=aa")
    assert "Duration" in output("show_recorder_actors_blocked")
    assert "Replaying File" in output("start_replaying", "-d=1")
    with open_recording(recordings / name) as recording:
        assert recording.info.frames > 10


@pytest.mark.parametrize("release", OTHERS)
def test_a_client_captures_the_world_of_a_server(port: int, release: str, tmp_path: Path) -> None:
    python_of(release)
    car = spawn(connect(port).get_world(), CAR, role_name="hero")
    output_of(release, "-m", "carla_recap", "capture", tmp_path / "a.mcap", f"--port={port}", "--duration=1")
    assert car.destroy()
    with open_recording(tmp_path / "a.mcap") as recording:
        hero = recording.actors[car.id]
        assert hero.type_id == CAR
        types = {each.key: each.type for each in hero.spawn.attributes}
    assert (types["role_name"], types["number_of_wheels"]) == (3, 1)


def test_a_client_of_another_release_than_the_servers_is_told_so(capfd: pytest.CaptureFixture[str]) -> None:
    with running(carla="0.9.14") as port:
        client = connect(port)
        for call in (client.get_world, client.get_available_maps):
            with pytest.raises(RuntimeError, match=r"expected a client of CARLA 0\.9\.14, found one of 0\.9\.16"):
                call()
        assert "found one of 0.9.16" in client.get_server_version()
    assert "expected a client of CARLA 0.9.14, found one of 0.9.16" in capfd.readouterr().err


def test_the_options_of_the_command_are_the_releases_of_the_table() -> None:
    assert set(CHOICES) == {"auto", *BY_NAME}


# --- which release a client is of ----------------------------------------------------------------------------------------

CONNECTS = """
import mmap, socket, sys
port, *libraries = sys.argv[1:]
files = [open(library, "rb") for library in libraries]
mapped = [mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) for file in files]
with socket.create_connection(("127.0.0.1", int(port))) as connection:
    connection.recv(1)
"""


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="the processes of this system cannot be looked at")
@pytest.mark.parametrize("release", [*RELEASES, None], ids=lambda release: release.name if release else "none")
def test_the_release_of_a_client_is_that_of_the_library_that_its_process_has_loaded(
    release: Release | None, tmp_path: Path
) -> None:
    library = tmp_path / "libcarla.cpython-311-x86_64-linux-gnu.so"
    older = RELEASES[RELEASES.index(release) :] if release else ()
    library.write_bytes(b"\0".join((b"other", *(each.marker for each in older), b"text")))
    other = tmp_path / "libcarla_msgs__rosidl_generator_py.so"
    other.write_bytes(b"messages of ROS")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        with subprocess.Popen([sys.executable, "-c", CONNECTS, str(port), library, other]) as process:
            connection, client = listening.accept()
            with connection:
                found = release_of(client, connection.getsockname())
                away = release_of(("192.0.2.1", client[1]), connection.getsockname())
                beside = release_of(("127.0.0.2", client[1]), connection.getsockname())
            assert process.wait(PATIENCE) == 0
    assert found is release
    assert away is beside is None


# --- rows of the table ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("release", "world", "rgb", "gnss", "v2x", "transform", "types", "spawn"),
    [
        ("0.9.13", 15, 12, 3, None, 5, 0, 4),
        ("0.9.14", 16, 13, 4, None, 6, 0, 4),
        ("0.9.15", 16, 13, 4, None, 6, 0, 4),
        ("0.9.16", 17, 13, 4, 20, 6, 1, 6),
        ("0.10.0", 16, 13, 4, None, 6, 0, 4),
    ],
)
def test_a_release_says_what_it_says_on_the_wire(
    release: str, world: int, rgb: int, gnss: int, v2x: int | None, transform: int, types: int, spawn: int
) -> None:
    row, inside = BY_NAME[release], Inside(BY_NAME[release])
    assert (row.number("world"), row.number("sensor.camera.rgb"), row.number("sensor.other.gnss")) == (world, rgb, gnss)
    assert row.number("sensor.other.v2x") == v2x
    assert inside.call("version") == release
    streams, kept = inside.host.streams, {}
    streams.keep = kept.__setitem__  # type: ignore[method-assign,assignment]
    inside.host.tick()
    assert struct.unpack_from("<Q", kept[inside.client.stream]) == (world,)
    definitions = {definition[1]: definition for definition in inside.call("get_actor_definitions")}
    assert ("sensor.other.v2x" in definitions) == (v2x is not None)
    car = next(definition for id, definition in definitions.items() if id.startswith("vehicle."))
    assert {attribute[0]: attribute[1] - types for attribute in car[3]}["number_of_wheels"] == 1
    attachment = [0, ""] if spawn == 6 else []
    then = [[transform, [0, [[510.0, 500.0, 0.5], [0.0, 0.0, 0.0]]]]]
    ((_, id),) = inside.batch([0, [DESCRIPTION, PLACE, [False], *attachment, [then]]])[0]
    (record,) = inside.call("get_actors_by_id", [id])
    assert {attribute[0]: attribute[1] - types for attribute in record[2][2]}["number_of_wheels"] == 1
    assert len(record[3]) == (4 if spawn == 6 else 3)
    assert record[4] == bytes([10 if release == "0.9.13" else 14])
    assert inside.world.actors[id].transform.location.x == pytest.approx(510.0, abs=0.01)


def test_all_releases_but_0_9_16_stay_on_their_stream_when_an_episode_begins() -> None:
    for release in RELEASES:
        inside = Inside(release)
        stream = inside.client.stream
        inside.call("load_new_episode", "")
        assert (inside.client.stream == stream) == (release.name != "0.9.16")
        assert inside.call("get_episode_info")[0] == inside.world.episode.number


def test_0_9_13_has_its_own_labels_commands_and_fields() -> None:
    inside = Inside(BY_NAME["0.9.13"])
    assert len(inside.call("get_weather_parameters")) == 13
    assert len(inside.call("get_episode_settings")) == 10
    inside.call("set_weather_parameters", [float(number) for number in range(13)])
    assert inside.world.weather.rayleigh_scattering_scale == 12.0
    lights = inside.call("get_environment_objects", 18)
    assert len(lights) == len(inside.call("get_all_level_BBs", 18)) == len(inside.world.traffic_lights)
    assert {light[4] for light in lights} == {18}
    assert len(inside.call("get_environment_objects", 255)) >= len(lights)
    point = inside.world.town.spawn_points[0].location
    found = inside.call("project_point", [point.x, point.y, point.z + 5], [0.0, 0.0, -1.0], 10.0)
    assert found[1][1] == 7
    assert inside.batch([18, [1, 2]])[0][0][0] == 0
    assert "vehicle.mitsubishi.fusorosa" not in {definition[1] for definition in inside.call("get_actor_definitions")}


def test_0_10_has_its_own_vehicles_which_are_as_large_as_the_similar_ones() -> None:
    inside = Inside(BY_NAME["0.10.0"])
    vehicles = [each[1] for each in inside.call("get_actor_definitions") if each[1].startswith("vehicle.")]
    assert len(vehicles) == 17
    answer = inside.call("spawn_actor", [0, "vehicle.lincoln.mkz", []], PLACE)
    box = inside.world.blueprints.get("vehicle.lincoln.mkz_2020").box
    assert answer[2][1] == "vehicle.lincoln.mkz"
    assert answer[3][1] == [box.extent.x, box.extent.y, box.extent.z]
    assert inside.call("get_actor_name", answer[0]) == f"vehicle.lincoln.mkz_{answer[0]}"
    assert inside.call("get_actor_class_name", answer[0]) == "vehicle.lincoln.mkz"
    assert inside.call("is_weather_enabled") is True


@pytest.mark.parametrize("name", ["0.9.13", "0.9.16", "0.10.0"])
def test_a_recording_is_as_the_release_writes_it(name: str, tmp_path: Path) -> None:
    inside = Inside(BY_NAME[name])
    inside.call("spawn_actor", [0, "vehicle.mini.cooper", []], PLACE)
    path = inside.call("start_recorder", str(tmp_path / "a.log"), True)
    for _ in range(2):
        inside.host.tick()
    inside.call("stop_recorder")
    inside.host.close()
    is_0_10 = name == "0.10.0"
    with open_recording(path) as recording:
        assert (recording.header.wide, recording.header.shifted) == (is_0_10, is_0_10)
        first = next(iter(recording.frames()))
        assert len(first["transforms"]) == 2
        assert bool(len(first["physics"])) is not is_0_10
    text = inside.call("show_recorder_file_info", path, True)
    assert "Positions: 2\n" in text


def test_the_physics_of_each_vehicle_come_back_from_0_10_as_they_were() -> None:
    release = BY_NAME["0.10.0"]
    encode, decode = encoder(PhysicsControl, release), decoder(PhysicsControl, release)
    for blueprint in standard_library().filter("vehicle.*"):
        assert blueprint.physics is not None
        wire = encode(blueprint.physics)
        assert (len(wire), {len(wheel) for wheel in wire[28]}) == (30, {38})
        assert release.completed(decode(json.loads(json.dumps(wire))), blueprint.physics) == blueprint.physics


def test_what_0_10_lacks_of_a_physics_control_is_kept() -> None:
    inside = Inside(BY_NAME["0.10.0"])
    car = inside.world.place("vehicle.lincoln.mkz", inside.world.town.spawn_points[0])
    assert isinstance(car, Vehicle)
    tuned = car.physics_control
    tuned.clutch_strength, tuned.damping_rate_full_throttle = 7.0, 0.3
    tuned.wheels[1].long_stiff_value = 1234.0
    tuned.forward_gears[1].up_ratio = 0.9
    car.physics_control = tuned
    wire = inside.call("get_physics_control", car.id)
    names = [each.name for each in fields(ChaosControl)]
    wire[names.index("mass")] = 1111.0
    wire[names.index("forward_gear_ratios")][1] = 2.5
    inside.call("apply_physics_control", car.id, wire)
    tuned.mass, tuned.forward_gears[1].ratio = 1111.0, 2.5
    assert car.physics_control == tuned
    wire[names.index("change_up_rpm")] = tuned.max_rpm / 2
    inside.call("apply_physics_control", car.id, wire)
    assert {gear.up_ratio for gear in car.physics_control.forward_gears} == {0.5}


def test_the_greatest_torque_of_0_10_scales_the_curve() -> None:
    control = ChaosControl.of(PhysicsControl(torque_curve=((0.0, 400.0), (5000.0, 200.0))))
    control.max_torque = 800.0
    assert control.plain().torque_curve == ((0.0, 800.0), (5000.0, 400.0))
