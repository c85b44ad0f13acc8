from __future__ import annotations

import asyncio
import gzip
import math
import re
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import carla
import pytest

import carla_recap
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.queries.info import info
from carla_recap.server import host as serving_host
from carla_recap.server import recordings as served
from carla_recap.server import running
from carla_recap.server.host import Host
from carla_recap.server.recordings import Recordings
from carla_recap.server.rpc.registry import CALLS
from carla_recap.sim import World, load_town
from carla_recap.sim.actors.moving import Vehicle, VehicleControl
from carla_recap.sim.geometry import Transform
from carla_recap.sim.replaying import replayer
from carla_recap.sim.town import loading
from carla_recap.sim.traffic import populate
from tests.samples import CARLA_LOGS
from tests.server.client import ticks
from tests.server.inside import Inside, client_inside
from tests.sim.recordings import disk_of, frames, run_until_it_fails

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import ModuleType

DELTA = 0.05
CARS = {"vehicle.audi.tt", "vehicle.tesla.model3"}
OTHER_MAP = "Otherfield"
OFFSET = [[0.0, 0.0, 40.0], [-80.0, 0.0, 0.0]]
QUERIES = (
    ("show_recorder_file_info", False),
    ("show_recorder_file_info", True),
    ("show_recorder_collisions", ord("a"), ord("a")),
    ("show_recorder_actors_blocked", 1.0, 100.0),
)
REPLAY = ("replay_file", 0.0, 0.0, 0)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of 4 s, in both formats: a parked car, and a hero that drives off; and one of another map."""
    folder = tmp_path_factory.mktemp("recordings")
    world = World(load_town(), date=0)
    places = world.town.spawn_points
    world.spawn("vehicle.audi.tt", places[0])
    hero = world.spawn("vehicle.tesla.model3", places[5], role_name="hero")
    world.spawn("sensor.other.collision", Transform(), parent=hero)
    assert isinstance(hero, Vehicle)
    hero.apply_control(VehicleControl(throttle=0.8))
    world.start_recorder(folder / "drive.mcap", additional_data=True)
    world.run(4.0)
    world.close()
    carla_recap.convert(folder / "drive.mcap", folder / "also.log")
    with carla_recap.create_recording(folder / "elsewhere.log", map_name=OTHER_MAP, date=0) as recording:
        recording.add_frame(0.0)
        recording.add_frame(5.0)
    with carla_recap.create_recording(folder / "nowhere.log", map_name="Carla/Maps/Town42", date=0) as recording:
        recording.add_frame(0.0)
    (folder / "text.log").write_text("hello")
    return folder


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with another map."""
    maps = tmp_path_factory.mktemp("maps")
    (maps / f"{OTHER_MAP}.xodr").write_text(load_town().opendrive)
    return maps


@pytest.fixture(scope="module")
def port(recordings: Path, maps: Path) -> Iterator[int]:
    """A server in UTC."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", "UTC")
        with running(recordings=recordings, maps=maps) as port:
            yield port


@pytest.fixture
def inside(recordings: Path, maps: Path) -> Iterator[Inside]:
    """A client inside a server that has the recordings."""
    inside = Inside(world=World(load_town(), recordings=recordings, maps=maps))
    yield inside
    inside.host.close()


def answers(inside: Inside, name: str) -> list[str]:
    """Return the answers to all queries about a recording."""
    return [inside.call(query, name, *arguments) for query, *arguments in QUERIES]


def hero_of(inside: Inside) -> Vehicle:
    return next(vehicle for vehicle in inside.world.vehicles.actors if vehicle.type_id == "vehicle.tesla.model3")


# --- recording -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "file"), [("one", "one.mcap"), ("two.mcap", "two.mcap"), ("three.log", "three.log")])
def test_a_recording_has_the_format_of_its_suffix(
    client: carla.Client, world: carla.World, recordings: Path, name: str, file: str
) -> None:
    assert client.start_recorder(name, True) == str(recordings / file)
    ticks(world, 10)
    client.stop_recorder()
    answer = client.show_recorder_file_info(name, True)
    assert answer.startswith("Version: 1\nMap: Brickfield\nDate: ")
    assert "Current platform time" in answer
    assert answer.endswith(f"\nFrames: 10\nDuration: {9 * DELTA:g} seconds\n")


@pytest.mark.parametrize("folder", ["/nowhere/at.all", "./absent"])
def test_a_folder_that_is_missing_elsewhere_is_answered_by_an_empty_text_and_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, folder: str
) -> None:
    with World(load_town(), recordings=tmp_path) as world:
        assert asyncio.run(Recordings(world).start(f"{folder}/a.log", False)) == ""
    (message,) = caplog.messages
    assert re.search(r"start_recorder: .*/a\.log: .*No such file", message)


def test_a_file_is_there_from_the_start_and_complete_without_another_call(client: carla.Client, world: carla.World) -> None:
    for count in (1, 5):
        path = Path(client.start_recorder("present.mcap"))
        assert path.exists()
        ticks(world, count)
        client.stop_recorder()  # which does not wait
        assert len(frames(path)) == count


def test_what_is_being_recorded_can_be_asked_about_later(inside: Inside) -> None:
    inside.call("start_recorder", "running", False)
    inside.host.tick()
    for query, *arguments in QUERIES:
        with pytest.raises(RecapError, match=r"running\.mcap is being recorded; .* after stop_recorder"):
            inside.call(query, "running", *arguments)
    assert "Duration" in inside.call("show_recorder_file_info", "drive", False)
    inside.call("stop_recorder")
    assert "Frames: 1\n" in inside.call("show_recorder_file_info", "running", False)


# --- queries -------------------------------------------------------------------------------------------------------------


def test_both_formats_answer_alike(inside: Inside) -> None:
    assert answers(inside, "drive") == answers(inside, "also.log")


@pytest.mark.skipif(
    not CARLA_LOGS.exists(), reason=f"{CARLA_LOGS} is not here: it is data that is not part of the repository"
)
@pytest.mark.parametrize("name", ["events", "collisions", "blocked", "magic_bad"])
def test_the_answers_are_those_of_carla(client: carla.Client, name: str) -> None:
    expected, path = CARLA_LOGS / "expected", str(CARLA_LOGS / f"{name}.log")
    assert client.show_recorder_file_info(path, False) == (expected / f"{name}.info.txt").read_text()
    whole = gzip.decompress((expected / f"{name}.info_all.txt.gz").read_bytes())
    assert client.show_recorder_file_info(path, True) == whole.decode()
    for types in ("aa", "hw", "vo", "vt"):
        answer = (expected / f"{name}.collisions_{types[0]}_{types[1]}.txt").read_text()
        assert client.show_recorder_collisions(path, *types) == answer
    for time, distance in ((0.5, 10), (60, 100)):
        answer = (expected / f"{name}.blocked_{time}_{distance}.txt").read_text()
        assert client.show_recorder_actors_blocked(path, time, distance) == answer


def test_what_is_no_recording_has_carlas_texts(inside: Inside, recordings: Path) -> None:
    for name, found, text in (
        ("absent.log", "absent.log", f"File {recordings / 'absent.log'} not found on server\n"),
        ("text", "text.log", "File is not a CARLA recorder\n"),
    ):
        assert answers(inside, name) == [text] * len(QUERIES)
        assert inside.call("replay_file", name, 0.0, 0.0, 0) == f"Replaying File: {recordings / found}\n{text}"


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("long" * 100, "cannot be read: .*File name too long"),
        *((name, "^'[^']+': expected the name of a recording$") for name in ("/", "./", "a\0b")),
        ("damaged.log", r"damaged\.log: byte \d+: "),
    ],
)
def test_names_that_no_recording_has_and_damaged_ones_are_errors(
    inside: Inside, recordings: Path, name: str, error: str
) -> None:
    data = bytearray((recordings / "also.log").read_bytes())
    begin = 2 + 2 + len("CARLA_RECORDER") + 8 + 2 + len("Brickfield")
    data[begin + 1] -= 1  # the size of the first frame's start
    (recordings / "damaged.log").write_bytes(data)
    for call, *arguments in (QUERIES[1], REPLAY):
        with pytest.raises(RecapError, match=error):
            inside.call(call, name, *arguments)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of other processes are Linux's")
def test_a_recording_that_a_full_disk_has_ended_is_an_error_that_tells_where_it_is(inside: Inside, tmp_path: Path) -> None:
    populate(inside.world, 10, 0)
    path = inside.call("start_recorder", str(tmp_path / "full.mcap"), True)
    disk_is_full = r"full\.mcap: cannot be written: File too large; what was recorded until then is in (.*\.partial)"
    with disk_of(inside.world, 60_000), pytest.warns(RecapWarning, match=f"the recording has ended: .*{disk_is_full}"):
        run_until_it_fails(inside.world)
    inside.call("stop_recorder")
    for call, *arguments in (*QUERIES, REPLAY):
        with pytest.raises(RecapError, match=f"the recording has ended early: .*{disk_is_full}") as failure:
            inside.call(call, path, *arguments)
    (partial_file,) = tmp_path.iterdir()
    assert str(partial_file) in str(failure.value)
    inside.call("start_recorder", path, False)
    inside.world.tick()
    inside.call("stop_recorder")
    assert "Frames: 1\n" in inside.call("show_recorder_file_info", path, False)


def test_an_answer_that_is_too_long_is_none(recordings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served, "_LONGEST", 1000)
    with pytest.raises(RecapError, match=r"drive\.mcap: the answer has more than 1000 bytes"):
        asyncio.run(served.answer(recordings / "drive.mcap", partial(info, all=True, compat=True)))


async def test_the_answers_of_a_client_are_made_one_by_one(inside: Inside, monkeypatch: pytest.MonkeyPatch) -> None:
    running_now, most = 0, 0

    async def answer(*_: object) -> str:
        nonlocal running_now, most
        running_now += 1
        most = max(most, running_now)
        await asyncio.sleep(0)
        running_now -= 1
        return "answer"

    monkeypatch.setattr(served, "answer", answer)
    other = client_inside(inside.host)
    info = CALLS["show_recorder_file_info"]
    assert await asyncio.gather(*(info(inside.client, ["drive", True]) for _ in range(5))) == ["answer"] * 5
    assert most == 1
    await asyncio.gather(*(info(client, ["drive", True]) for client in (inside.client, other)))
    assert most == 2, "another client waits"


# --- replaying -----------------------------------------------------------------------------------------------------------


def test_a_replay_is_told_as_by_carla(inside: Inside, recordings: Path) -> None:
    total = f"{4 - DELTA:g}"
    assert inside.call("replay_file", "drive", 0.0, 0.0, 0) == (
        f"Replaying File: {recordings / 'drive.mcap'}\n"
        f"Total time recorded: {total}\n"
        f"Replaying from 0 s - {total} s ({total} s) at 1.0x\n"
        "Ignoring Spectator camera\n"
    )
    inside.call("set_replayer_time_factor", 2.5)
    inside.call("set_replayer_ignore_hero", True)
    inside.call("set_replayer_ignore_spectator", False)
    assert inside.call("replay_file", "also.log", -3.0, 10.0, 0) == (
        f"Replaying File: {recordings / 'also.log'}\n"
        f"Total time recorded: {total}\n"
        f"Replaying from 0.95 s - 10.95 s ({total} s) at 2.5x\n"
        "Ignoring Hero vehicle\n"
    )


def test_a_recording_of_an_unknown_map_replays_on_its_corridors(inside: Inside) -> None:
    with pytest.warns(RecapWarning, match="there is no map 'Town42'"):
        answer = inside.call("replay_file", "nowhere", 0.0, 0.0, 0).splitlines()
    assert answer[1] == "Loading map Carla/Maps/Town42"
    assert "There is no map Carla/Maps/Town42: the corridors that the vehicles have driven are its roads" in answer
    assert inside.call("get_map_info")[0] == "Carla/Maps/Town42"


def test_a_replay_from_beyond_the_end_is_told_as_by_carla(inside: Inside) -> None:
    with pytest.warns(RecapWarning, match=r"drive\.mcap: the replay starts at its end, 3\.95 s, instead of 99 s"):
        answer = inside.call("replay_file", "drive", 99.0, 0.0, 0)
    assert "Replaying from 99 s - 3.95 s (3.95 s) at 1.0x\n" in answer
    assert {vehicle.type_id for vehicle in inside.world.vehicles.actors} == CARS
    inside.world.tick()
    assert not inside.world.replayer.is_playing


def test_a_replay_that_follows_a_missing_actor_runs_without_following(inside: Inside) -> None:
    before = inside.world.spectator.transform
    with pytest.warns(RecapWarning, match="follows no actor: .* no actor 4242 to follow; known ids are"):
        answer = inside.call("replay_file", "drive", 0.0, 0.0, 4242)
    assert "Replaying from 0 s - 3.95 s" in answer
    inside.world.tick()
    assert inside.world.replayer.is_playing
    assert inside.world.spectator.transform == before


@pytest.mark.parametrize("how", ["autopilot", "control", "batch", "ackermann"])
def test_a_client_takes_over_a_vehicle_after_a_replay(inside: Inside, how: str) -> None:
    inside.world.replay_file("drive", start=2.0)
    inside.world.run(0.5)
    inside.call("stop_replayer", True)
    inside.world.run(0.1)
    hero = hero_of(inside)
    assert hero.autopilot
    brake = [0.0, 0.0, 1.0, False, False, False, 0]
    if how == "autopilot":
        inside.call("set_actor_autopilot", hero.id, False)
    elif how == "control":
        inside.call("apply_control_to_vehicle", hero.id, brake)
    elif how == "batch":
        inside.batch([2, [hero.id, brake]])
    else:
        inside.call("apply_ackermann_control_to_vehicle", hero.id, [0.0, 0.0, 0.0, 0.0, 0.0])
    inside.host.tick()
    assert not hero.autopilot
    assert (hero.control.throttle, hero.control.brake > 0.0) == (0.0, how != "autopilot")


def test_that_a_client_cannot_drive_a_replayed_vehicle_is_logged_once(
    inside: Inside, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(2):
        inside.call("replay_file", "drive", 0.0, 0.0, 0)
        for vehicle in list(inside.world.vehicles.actors):
            inside.call("set_actor_autopilot", vehicle.id, True)
            inside.call("apply_control_to_vehicle", vehicle.id, [0.0, 0.0, 1.0, False, False, False, 0])
        assert caplog.text.count("follows a recording") == number + 1


def test_that_a_recording_ends_another_or_a_replay_is_logged(
    inside: Inside, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    inside.call("start_recorder", str(tmp_path / "first.log"))
    assert not caplog.records
    inside.call("start_recorder", str(tmp_path / "second.log"))
    assert re.search(r"the recording of \S+first\.log ends, since \S+second\.log begins", caplog.text)
    inside.call("replay_file", "drive", 0.0, 0.0, 0)
    inside.call("start_recorder", str(tmp_path / "third.log"))
    assert re.search(r"the replay of \S+drive\.mcap ends", caplog.text)


def test_a_recording_of_another_map_begins_an_episode(
    client: carla.Client, world: carla.World, other_client: carla.Client
) -> None:
    watched = other_client.get_world()
    frame = world.tick()
    ids = {actor.id for actor in world.get_actors()}
    answer = client.replay_file("elsewhere.log", 0.0, 0.0, 0).splitlines()
    assert answer[1:4] == [
        f"Loading map {OTHER_MAP}",
        "Replayer will start after map is loaded...",
        "Total time recorded: 5",
    ]
    now = client.get_world()
    assert now.id != world.id
    assert now.get_map().name.endswith(OTHER_MAP)
    assert now.tick() > frame
    assert ids.isdisjoint(actor.id for actor in now.get_actors())
    assert other_client.get_world().get_map().name.endswith(OTHER_MAP)
    assert watched.get_snapshot().frame > frame
    assert "Loading map Brickfield\n" in client.replay_file("drive", 0.0, 0.0, 0)


@pytest.mark.parametrize(
    "options", [(), (False,), (False, OFFSET), (False, OFFSET, ""), (False, True, OFFSET, ""), (False, False, OFFSET)]
)
def test_the_options_of_older_and_newer_clients_are_accepted(inside: Inside, options: tuple[object, ...]) -> None:
    inside.world.weather = replace(inside.world.weather, cloudiness=77.0)
    (id,) = re.findall(r"Create (\d+): vehicle\.tesla", inside.call("show_recorder_file_info", "drive", False))
    answer = inside.call("replay_file", "drive", 0.0, 0.0, int(id), *options)
    assert "Total time recorded: 3.95\n" in answer
    assert inside.world.weather.cloudiness == (77.0 if options[:2] == (False, False) else 0.0)
    inside.host.tick()
    camera, car = inside.world.spectator.transform, hero_of(inside).transform
    pitch, away = (-80.0, 40.0) if OFFSET in options else (-25.0, math.hypot(10.0, 5.0))  # from behind, as in CARLA
    assert camera.rotation.pitch == pytest.approx(pitch)
    assert camera.location.distance(car.location) == pytest.approx(away, abs=0.01)


def test_a_newer_client_can_name_the_map_of_a_replay_and_other_options_are_errors(inside: Inside) -> None:
    answer = inside.call("replay_file", "nowhere", 0.0, 0.0, 0, False, True, OFFSET, "Brickfield")
    assert "Total time recorded: 0\n" in answer
    for options in ((1,), ("Brickfield", "Brickfield"), (True, True, True), ({},), (OFFSET, OFFSET)):
        with pytest.raises(RecapError, match="replay_file"):
            inside.call("replay_file", "drive", 0.0, 0.0, 0, *options)


def test_a_recording_ends_a_replay_unless_a_newer_client_records_it(inside: Inside, tmp_path: Path) -> None:
    for arguments, goes_on in (((False,), False), ((False, True), False), ((False, False), True)):
        inside.world.replay_file("drive")
        path = inside.call("start_recorder", str(tmp_path / "again.log"), *arguments)
        inside.world.tick()
        assert inside.world.replayer.is_playing == goes_on
        inside.world.close()
        assert len(frames(Path(path))) == 1 + goes_on  # that of a replay begins with its start


# --- while others are served ---------------------------------------------------------------------------------------------


class Blocked:
    """Something slow, which ends when other clients have been served; as long as it runs on the event loop, none is."""

    def __init__(self, work: Callable[..., Any]) -> None:
        self._work = work
        self._has_begun, self._others_served = threading.Event(), threading.Event()

    def __call__(self, *arguments: Any) -> Any:
        self._has_begun.set()
        assert self._others_served.wait(60.0), "other clients wait"
        return self._work(*arguments)

    async def serve_others(self, host: Host) -> None:
        while not self._has_begun.is_set():
            await asyncio.sleep(0)
        CALLS["get_episode_info"](client_inside(host), [])
        host.tick()
        self._others_served.set()


@pytest.mark.parametrize(
    ("call", "of", "slow"),
    [
        (("replay_file", "drive", 0.0, 0.0, 0), replayer, "open_reader"),
        (("replay_file", "elsewhere", 0.0, 0.0, 0), loading, "make_town"),
        (("start_recorder", "new.mcap", False), served, "start_process"),
    ],
    ids=["a recording is opened", "a map is loaded", "the process that writes starts"],
)
async def test_clients_are_served_meanwhile(
    inside: Inside, monkeypatch: pytest.MonkeyPatch, call: tuple[Any, ...], of: ModuleType, slow: str
) -> None:
    monkeypatch.setattr(loading, "_towns", {})
    blocked, (name, *arguments) = Blocked(getattr(of, slow)), call
    monkeypatch.setattr(of, slow, blocked)
    answer, _ = await asyncio.gather(CALLS[name](inside.client, arguments), blocked.serve_others(inside.host))
    assert "Total time recorded" in answer or "new.mcap" in answer


async def test_clients_are_served_while_the_actors_of_a_replay_are_spawned(
    recordings: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serving_host, "_SLICE", 0.0)
    host = Host(World(load_town(called="Elsewhere")))
    present: list[int] = []
    published: list[int] = []
    monkeypatch.setattr(host, "publish", lambda: published.append(len(host.world.vehicles)))
    replay = asyncio.ensure_future(CALLS["replay_file"](client_inside(host), [str(recordings / "drive.mcap"), 0.0, 0.0, 0]))
    while not host.batches:
        await asyncio.sleep(0)
    while host.batches:
        present.append(len(host.world.vehicles))
        await asyncio.sleep(0)
    assert "Total time recorded: 3.95\n" in await replay
    assert {1, 2} <= set(present)
    assert published == [2]  # the first snapshot of the episode has all actors
    host.close()


@pytest.mark.parametrize(
    ("ending", "arguments"),
    [
        ("stop_recorder", []),
        ("start_recorder", ["next.mcap", False]),
        ("replay_file", ["drive", 0.0, 0.0, 0]),
        ("load_new_episode", ["", True, 0]),
    ],
)
async def test_clients_are_served_while_a_recording_is_completed(inside: Inside, ending: str, arguments: list[Any]) -> None:
    await CALLS["start_recorder"](inside.client, ["ends.mcap", False])
    inside.host.tick()
    completing = Blocked(inside.world.recorder._writer.close)
    inside.world.recorder._finish = completing
    answer = CALLS[ending](inside.client, arguments)
    task = answer if asyncio.iscoroutine(answer) else asyncio.sleep(0)
    await asyncio.gather(task, completing.serve_others(inside.host))
    assert b"Frames: 1\n" in await CALLS["show_recorder_file_info"](inside.client, ["ends.mcap", False])


async def test_a_recording_that_cannot_be_completed_is_logged_and_others_can_be_asked_about(
    inside: Inside, caplog: pytest.LogCaptureFixture
) -> None:
    def fail() -> None:
        raise OSError("lost")

    await CALLS["start_recorder"](inside.client, ["ends.mcap", False])
    inside.host.tick()
    writer = inside.world.recorder._writer
    inside.world.recorder._finish = fail
    CALLS["stop_recorder"](inside.client, [])
    writer.close()
    assert b"Frames: 80\n" in await CALLS["show_recorder_file_info"](inside.client, ["drive", False])
    assert "a recording could not be completed: lost" in caplog.messages


# --- confined ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def confined(inside: Inside) -> Inside:
    inside.host.recordings._confined = True
    return inside


def test_a_confined_server_serves_its_folder(confined: Inside, recordings: Path) -> None:
    for name in ("drive", "also.log", str(recordings / "drive.mcap")):
        assert "Brickfield" in confined.call("show_recorder_file_info", name, False)
        assert "Total time recorded" in confined.call("replay_file", name, 0.0, 0.0, 0)
    assert confined.call("start_recorder", f"{recordings}/own.log") == str(recordings / "own.log")


def test_a_confined_server_keeps_to_its_folder(confined: Inside, recordings: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.log"
    outside.write_bytes((recordings / "also.log").read_bytes())
    (recordings / "link.log").symlink_to(outside)
    (recordings / "links").symlink_to(tmp_path)
    (recordings / "loop.log").symlink_to(recordings / "loop.log")
    names = [str(outside), f"{recordings}/../{tmp_path.name}/x.log", "link", "link.log", f"{recordings}/links/outside.log"]
    for name in [*names, ".", "..", "../x", "loop.log"]:
        recorder = [("start_recorder",)] if name != "link" else []  # a new link.mcap is as good as any
        for call, *arguments in (*QUERIES, REPLAY, *recorder):
            with pytest.raises(RecapError, match="is outside the folder of recordings"):
                confined.call(call, name, *arguments)
