"""The fixtures for users' tests, in runs of pytest of their own, with CARLA's client."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from textwrap import dedent
from typing import NamedTuple
from xml.etree import ElementTree

import pytest

from carla_recap import open_recording
from tests.show.page.conftest import data
from tests.waiting import PATIENCE

pytestmark = pytest.mark.skipif(
    not all(map(find_spec, ("carla", "pymunk", "msgpack"))), reason="the extra `server` is not installed"
)

COMMON = """
import carla
import os
import pytest
from pathlib import Path

def spawn(world, name, point, **attributes):
    blueprint = world.get_blueprint_library().find(name)
    for key, value in attributes.items():
        blueprint.set_attribute(key, value)
    return world.spawn_actor(blueprint, point)

def crash(run):
    point = run.world.get_map().get_spawn_points()[0]
    forward = point.get_forward_vector()
    hero = spawn(run.world, "vehicle.tesla.model3", point, role_name="hero")
    spawn(run.world, "vehicle.audi.tt", carla.Transform(point.location + 12 * forward, point.rotation))
    run.tick()
    sensor = run.world.get_blueprint_library().find("sensor.other.collision")
    run.world.spawn_actor(sensor, carla.Transform(), attach_to=hero)
    run.tick()
    hero.enable_constant_velocity(carla.Vector3D(10, 0, 0))
    run.tick(2)
"""
RULES = '[rules.harmless]\ncollisions = { of = "hero", max = 0 }\n'
TESTS = """
def vehicles(run):
    return len(run.world.get_actors().filter("vehicle.*"))

def test_the_server_alone(carla_server):
    client = carla.Client("127.0.0.1", carla_server)
    client.set_timeout(600.0)
    assert any(name.endswith("Brickfield") for name in client.get_available_maps())

def test_leaves_a_replay_settings_and_weather(carla_world):
    assert carla_world.world.get_settings().synchronous_mode
    crash(carla_world)
    path = carla_world.stop_recording()
    for actor in carla_world.world.get_actors().filter("vehicle.*"):
        actor.destroy()
    carla_world.tick()
    carla_world.client.replay_file(str(path), 0, 0, 0, False)
    carla_world.tick()
    assert vehicles(carla_world) == 2
    carla_world.world.set_weather(carla.WeatherParameters(cloudiness=50.0))
    carla_world.world.apply_settings(carla.WorldSettings(synchronous_mode=False, fixed_delta_seconds=0.02))

def test_gets_a_clean_world(carla_world):
    settings = carla_world.world.get_settings()
    assert (settings.synchronous_mode, round(settings.fixed_delta_seconds, 6)) == (True, 0.05)
    assert carla_world.world.get_weather().cloudiness == 0
    assert vehicles(carla_world) == 0
    time = carla_world.world.get_snapshot().timestamp.elapsed_seconds
    assert time < 1
    assert round(time % 0.05, 6) in (0, 0.05)  # no tick was by the clock
    carla_world.tick()
    assert vehicles(carla_world) == 0

def test_is_recorded_and_meets_rules(carla_world):
    crash(carla_world)
    assert len(open_recording(carla_world.stop_recording()).collisions()) > 0
    carla_world.assert_rules(collisions={"of": "hero", "min": 1}, map="Brickfield")

@pytest.mark.parametrize("time", range(2))
def test_all_drive_off(carla_world, time):
    manager = carla_world.traffic_manager
    for point in carla_world.world.get_map().get_spawn_points()[:3]:
        spawn(carla_world.world, "vehicle.tesla.model3", point).set_autopilot(True, manager.get_port())
    carla_world.tick(2)
    cars = carla_world.world.get_actors().filter("vehicle.*")
    assert [car.get_velocity().length() > 1 for car in cars] == [True] * 3

@pytest.mark.carla(map="Atlantis")
def test_wants_an_unknown_map(carla_world):
    pass

@pytest.mark.carla(map="Walled", fixed_delta_seconds=0.1)
def test_is_on_another_map(carla_world):
    assert carla_world.world.get_map().name.endswith("Walled")
    assert round(carla_world.world.get_settings().fixed_delta_seconds, 6) == 0.1

def test_is_on_the_built_in_map_again(carla_world):
    assert carla_world.world.get_map().name.endswith("Brickfield")

kept = []

@pytest.mark.carla(synchronous=False)
def test_leaves_sensors_and_a_callback(carla_world):
    world = carla_world.world
    car = spawn(world, "vehicle.tesla.model3", world.get_map().get_spawn_points()[0])
    for name in ("other.imu", "other.gnss", "lidar.ray_cast"):
        sensor = world.get_blueprint_library().find("sensor." + name)
        kept.append(world.spawn_actor(sensor, carla.Transform(), attach_to=car))
        kept[-1].listen(kept.append)
    world.on_tick(kept.append)
    world.wait_for_tick(60.0)

@pytest.mark.carla(town="Brickfield")
def test_has_a_wrong_marker(carla_world):
    pass

def test_fails_and_leaves_the_world_without_ticks(carla_world):
    crash(carla_world)
    assert False

def test_breaks_rules(carla_world):
    crash(carla_world)
    carla_world.assert_rules("rules.toml")

@pytest.mark.carla(rules="rules.toml")
def test_breaks_the_rules_of_its_marker(carla_world):
    crash(carla_world)

@pytest.mark.xfail
def test_is_expected_to_fail(carla_world):
    assert False

@pytest.fixture
def broken(carla_world):
    carla_world.tick()
    assert False

def test_has_a_broken_fixture(broken):
    pass

def test_ends_the_server(carla_world):
    (server,) = Path("/proc/self/task", str(os.getpid()), "children").read_text().split()
    os.kill(int(server), 9)
    os.waitid(os.P_PID, int(server), os.WEXITED | os.WNOWAIT)

def test_gets_another_server(carla_world, carla_server):
    assert vehicles(carla_world) == 0
"""
UNHAPPY = {
    "test_wants_an_unknown_map": "error",
    "test_has_a_wrong_marker": "error",
    "test_fails_and_leaves_the_world_without_ticks": "failure",
    "test_breaks_rules": "failure",
    "test_breaks_the_rules_of_its_marker": "failure",
    "test_is_expected_to_fail": "skipped",
    "test_has_a_broken_fixture": "error",
}
KEPT = (
    "test_fails_and_leaves_the_world_without_ticks",
    "test_breaks_rules",
    "test_breaks_the_rules_of_its_marker",
    "test_has_a_broken_fixture",
)


class Run(NamedTuple):
    """A run of pytest: its output, the results of its tests by name, and its folder."""

    output: str
    results: dict[str, list[ElementTree.Element]]
    folder: Path

    def section(self, test: str) -> str:
        """Return what the output has of a test that fails."""
        _, *parts = re.split(r"^_{3,} (?:ERROR at setup of )?(\w+) _{3,}$", self.output, flags=re.MULTILINE)
        return parts[parts.index(test) + 1]


def started(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--basetemp=temporary", *options]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE, check=False)


def run_pytest(folder: Path, *options: str) -> Run:
    done = started(folder, "--junitxml=out.xml", *options)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    cases = ElementTree.parse(folder / "out.xml").iter("testcase")
    return Run(done.stdout + done.stderr, {case.get("name", ""): list(case) for case in cases}, folder)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run of many tests, one after another."""
    from carla_recap.sim import load_town

    folder = tmp_path_factory.mktemp("users")
    (folder / "maps").mkdir()
    (folder / "maps" / "Walled.xodr").write_text(load_town().opendrive)
    (folder / "rules.toml").write_text(RULES)
    (folder / "test_drive.py").write_text("from carla_recap import open_recording\n" + COMMON + TESTS)
    (folder / "carla-recordings").mkdir()
    (folder / "carla-recordings" / "test_drive-test_is_recorded_and_meets_rules.html").touch()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CARLA_RECAP_MAPS", str(folder / "maps"))
        return run_pytest(folder)


@pytest.mark.parametrize("name", re.findall(r"^def (test_\w+)", TESTS, re.MULTILINE))
def test_a_users_test(run: Run, name: str) -> None:
    cases = [
        case for test, children in run.results.items() if test.partition("[")[0] == name for case in (children or [None])
    ]
    assert cases
    found = [child.tag for child in cases if child is not None and child.tag in ("failure", "error", "skipped")]
    assert found == ([UNHAPPY[name]] if name in UNHAPPY else []), run.output


def test_the_recordings_and_pages_of_failed_tests_are_kept_and_no_others(run: Run) -> None:
    kept = sorted(path.name for path in (run.folder / "carla-recordings").iterdir())
    assert kept == sorted(f"test_drive-{name}{suffix}" for name in KEPT for suffix in (".mcap", ".html"))


@pytest.mark.parametrize("name", ["test_breaks_rules", "test_breaks_the_rules_of_its_marker"])
def test_broken_rules_are_named_and_the_page_opens_at_the_offence(run: Run, name: str) -> None:
    section, stem = run.section(name), run.folder / "carla-recordings" / f"test_drive-{name}"
    assert "1 of 1 rules are broken" in section
    assert "harmless: 1 collision of the hero instead of at most 0: hero collides with vehicle.audi.tt" in section
    assert "def assert_rules" not in section
    assert "def pytest_runtest_call" not in section
    assert f"recording: {stem}.mcap\npage: {stem}.html" in section
    opening = data(Path(f"{stem}.html"), "report")["opening"]
    assert 0 < opening["time"] < 3
    assert [note.partition(":")[0] for note in opening["notes"]] == ["harmless"]


def test_the_page_of_a_failed_assert_opens_at_the_last_incident(run: Run) -> None:
    report = data(run.folder / "carla-recordings" / f"test_drive-{KEPT[0]}.html", "report")
    last = report["incidents"][-1]
    assert last["start"] > 0
    assert report["opening"] == {"time": last["start"], "actors": last["actors"], "notes": []}


def test_a_kept_recording_is_complete(run: Run) -> None:
    with open_recording(run.folder / "carla-recordings" / f"test_drive-{KEPT[0]}.mcap") as recording:
        assert recording.info.frames == 42
        assert recording.info.additional_data


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("test_wants_an_unknown_map", "'Atlantis': there is no such map"),
        ("test_has_a_wrong_marker", "the marker carla takes map=, rules=, fixed_delta_seconds=, synchronous= alone"),
    ],
)
def test_what_is_wrong_with_a_marker_is_said(run: Run, name: str, message: str) -> None:
    assert message in run.section(name)


@pytest.fixture(scope="module")
def parallel(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run in two processes, with options, of tests of which one breaks the rules."""
    pytest.importorskip("xdist", reason="pytest-xdist is not installed")
    folder = tmp_path_factory.mktemp("parallel")
    (folder / "rules.toml").write_text(RULES)
    (folder / "test_drive.py").write_text(
        COMMON
        + dedent("""
        @pytest.mark.parametrize("number", range(3))
        def test_mine(carla_world, carla_server, number):
            point = carla_world.world.get_map().get_spawn_points()[3]
            spawn(carla_world.world, "vehicle.audi.tt", point).apply_control(carla.VehicleControl(0.5))
            carla_world.tick(1)
            print(f"port {carla_server}")
            if number == 2:
                crash(carla_world)
        """)
    )
    options = ("release=0.9.16", "rules=rules.toml", "dir=out", "keep=all")
    return run_pytest(folder, "-n2", "--dist=load", "-rA", *(f"--carla-recap-{option}" for option in options))


def test_an_option_gives_rules_for_all_tests_and_each_worker_has_a_server(parallel: Run) -> None:
    assert len(set(re.findall(r"port (\d+)", parallel.output))) == 2
    failed = {name for name, children in parallel.results.items() if any(child.tag == "failure" for child in children)}
    assert (len(parallel.results), failed) == (3, {"test_mine[2]"})
    assert "\nharmless: 1 collision of the hero instead of at most 0" in parallel.output


def test_options_give_a_folder_where_all_recordings_are_kept(parallel: Run) -> None:
    found = {path.name for path in (parallel.folder / "out").iterdir()}
    assert found == {*(f"test_drive-test_mine-{number}.mcap" for number in range(3)), "test_drive-test_mine-2.html"}


def test_the_same_test_gives_the_same_recording(parallel: Run) -> None:
    first, again = (parallel.folder / "out" / f"test_drive-test_mine-{each}.mcap" for each in (0, 1))
    with open_recording(first) as one, open_recording(again) as other:
        assert one.diff(other).equal
        times, others = (recording.table("light_states")["elapsed"].tolist() for recording in (one, other))
    assert times == others


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("rules=nope.toml", "nope.toml: cannot be read: No such file or directory"),
        ("rules=wrong.toml", "wrong.toml: rule 'a': unknown condition 'maps'"),
        ("dir=wrong.toml", "--carla-recap-dir: FOLDER/wrong.toml: is a file; a folder was expected"),
        ("release=0.9.99", "expected a release of CARLA (0.10.0, "),
    ],
)
def test_a_wrong_option_is_an_error_of_one_line_at_the_start(tmp_path: Path, option: str, message: str) -> None:
    (tmp_path / "wrong.toml").write_text("[rules.a]\nmaps = 'x'\n[rules.b]\nframes = { max = -1 }\n")
    (tmp_path / "test_none.py").write_text("def test_none(carla_server): pass")
    done = started(tmp_path, f"--carla-recap-{option}")
    (line,) = done.stderr.strip().splitlines()
    assert (done.returncode, done.stdout) == (pytest.ExitCode.USAGE_ERROR, "")
    assert line.startswith("ERROR: ")
    assert message.replace("FOLDER", str(tmp_path)) in line


def test_tests_without_options_run_beside_a_file_that_is_called_like_the_folder(tmp_path: Path) -> None:
    (tmp_path / "carla-recordings").touch()
    (tmp_path / "test_none.py").write_text("def test_none(): pass")
    assert started(tmp_path).returncode == pytest.ExitCode.OK


def test_files_of_tests_are_named_after_them() -> None:
    from carla_recap.pytest_plugin import _file_name as names

    assert names("tests/a/test_b.py::TestC::test_d[x-1.5]") == "tests-a-test_b-TestC-test_d-x-1.5"
    assert names("a/b.py::test_d") != names("a-b.py::test_d")
    awkward = [names(f"test_b.py::test_d[{value}]") for value in ("a/b", "a b", "a-b", "../..", "ä\0", "x" * 4000)]
    assert len(set(awkward)) == len(awkward)
    assert all(re.fullmatch(r"[\w.-]{1,140}", name) and ".." not in name.split("-")[0] for name in awkward)
