from __future__ import annotations

import asyncio
import gzip
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
from carla_recap.errors import Closed, RecapError, RecapWarning
from carla_recap.formats import open_reader
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
from carla_recap.sim.traffic import populate
from tests.samples import CARLA_LOGS
from tests.server.client import connect, ticks
from tests.server.inside import Inside, client_inside
from tests.sim.recordings import disk_of, frames, run_until_it_fails

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

DELTA = 0.05
CARS = {"vehicle.audi.tt", "vehicle.tesla.model3"}
OTHER_MAP = "Otherfield"
OFFSET = [[-10.0, 0.0, 5.0], [-25.0, 0.0, 0.0]]


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
def port(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """A server in UTC, which has another map."""
    maps = tmp_path_factory.mktemp("maps")
    (maps / f"{OTHER_MAP}.xodr").write_text(load_town().opendrive)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", "UTC")
        with running(recordings=recordings, maps=maps) as port:
            yield port


@pytest.fixture(autouse=True)
def _as_at_first(client: carla.Client) -> Iterator[None]:
    """Nothing of what a test sets stays."""
    yield
    client.set_replayer_time_factor(1.0)
    client.set_replayer_ignore_hero(False)
    client.set_replayer_ignore_spectator(True)


def vehicles(world: carla.World) -> dict[str, carla.Actor]:
    return {actor.type_id: actor for actor in world.get_actors().filter("vehicle.*")}


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


def test_what_is_being_recorded_can_be_asked_about_later(client: carla.Client, world: carla.World, recordings: Path) -> None:
    client.start_recorder("running")
    world.tick()
    for ask in queries_of("running"):
        with pytest.raises(RuntimeError, match=r"running\.mcap is being recorded; .* after stop_recorder"):
            ask(client)
    assert "Duration" in client.show_recorder_file_info("drive", False)
    client.stop_recorder()
    assert "Frames: 1\n" in client.show_recorder_file_info("running", False)


# --- queries -------------------------------------------------------------------------------------------------------------


def queries_of(name: str) -> list[Callable[[carla.Client], str]]:
    return [
        lambda client: client.show_recorder_file_info(name, False),
        lambda client: client.show_recorder_file_info(name, True),
        lambda client: client.show_recorder_collisions(name, "a", "a"),
        lambda client: client.show_recorder_actors_blocked(name, 1.0, 100.0),
    ]


def test_both_formats_answer_alike(client: carla.Client) -> None:
    for of_mcap, of_log in zip(queries_of("drive"), queries_of("also.log"), strict=True):
        answer = of_mcap(client)
        assert answer == of_log(client)
        assert "Map: Brickfield\nDate: 01/01/70 00:00:00\n\n" in answer


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


def test_what_is_no_recording_has_carlas_texts(client: carla.Client, recordings: Path) -> None:
    for name, found, text in (
        ("absent.log", "absent.log", f"File {recordings / 'absent.log'} not found on server\n"),
        ("text", "text.log", "File is not a CARLA recorder\n"),
    ):
        for ask in queries_of(name):
            assert ask(client) == text
        assert client.replay_file(name, 0.0, 0.0, 0) == f"Replaying File: {recordings / found}\n{text}"
    for ask in queries_of("long" * 100):
        with pytest.raises(RuntimeError, match=r"cannot be read: .*File name too long"):
            ask(client)
    for name in ("/", "./", "a\0b"):
        for ask in queries_of(name):
            with pytest.raises(RuntimeError, match=r"^'[^']+': expected the name of a recording$"):
                ask(client)


def test_a_damaged_recording_is_an_error_that_tells_where(client: carla.Client, recordings: Path) -> None:
    data = bytearray((recordings / "also.log").read_bytes())
    begin = 2 + 2 + len("CARLA_RECORDER") + 8 + 2 + len("Brickfield")
    data[begin + 1] -= 1  # the size of the first frame's start
    (recordings / "damaged.log").write_bytes(data)
    with pytest.raises(RuntimeError, match=r"damaged\.log: byte \d+: "):
        client.show_recorder_file_info("damaged.log", True)
    with pytest.raises(RuntimeError, match=r"damaged\.log: byte \d+: "):
        client.replay_file("damaged.log", 0.0, 0.0, 0)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of other processes are Linux's")
def test_a_recording_that_a_full_disk_has_ended_is_an_error_that_tells_where_it_is(tmp_path: Path) -> None:
    inside = Inside()
    populate(inside.world, 10, 0)
    path = inside.call("start_recorder", str(tmp_path / "full.mcap"), True)
    disk_is_full = r"full\.mcap: cannot be written: File too large; what was recorded until then is in (.*\.partial)"
    with disk_of(inside.world, 60_000), pytest.warns(RecapWarning, match=f"the recording has ended: .*{disk_is_full}"):
        run_until_it_fails(inside.world)
    inside.call("stop_recorder")
    for name, arguments in (
        ("show_recorder_file_info", (False,)),
        ("show_recorder_collisions", (97, 97)),
        ("show_recorder_actors_blocked", (1.0, 100.0)),
        ("replay_file", (0.0, 0.0, 0)),
    ):
        with pytest.raises(RecapError, match=f"the recording has ended early: .*{disk_is_full}") as failure:
            inside.call(name, path, *arguments)
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


async def test_the_answers_of_a_client_are_made_one_by_one(recordings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside, running_now, most = Inside(), 0, 0
    inside.host.recordings._world.recordings = recordings

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


@pytest.mark.parametrize("name", ["drive", "also.log"])
def test_a_replay_is_told_as_by_carla(client: carla.Client, recordings: Path, name: str) -> None:
    path = recordings / ("drive.mcap" if name == "drive" else name)
    total = f"{4 - DELTA:g}"
    assert client.replay_file(name, 0.0, 0.0, 0) == (
        f"Replaying File: {path}\n"
        f"Total time recorded: {total}\n"
        f"Replaying from 0 s - {total} s ({total} s) at 1.0x\n"
        "Ignoring Spectator camera\n"
    )
    client.set_replayer_time_factor(2.5)
    client.set_replayer_ignore_hero(True)
    client.set_replayer_ignore_spectator(False)
    assert client.replay_file(name, -3.0, 10.0, 0) == (
        f"Replaying File: {path}\n"
        f"Total time recorded: {total}\n"
        f"Replaying from 0.95 s - 10.95 s ({total} s) at 2.5x\n"
        "Ignoring Hero vehicle\n"
    )


def test_a_recording_of_an_unknown_map_replays_on_its_corridors(client: carla.Client, world: carla.World) -> None:
    before = world.get_map().name
    answer = client.replay_file("nowhere", 0.0, 0.0, 0).splitlines()
    assert answer[1] == "Loading map Carla/Maps/Town42"
    assert "There is no map Carla/Maps/Town42: the corridors that the vehicles have driven are its roads" in answer
    there = client.get_world()
    assert there.get_map().name.endswith("Town42")
    assert len(there.get_map().generate_waypoints(5.0)) > 2
    client.load_world(before)


def test_a_replay_from_beyond_the_end_is_told_as_by_carla(recordings: Path) -> None:
    inside = Inside()
    with pytest.warns(RecapWarning, match=r"drive\.mcap: the replay starts at its end, 3\.95 s, instead of 99 s"):
        answer = inside.call("replay_file", str(recordings / "drive.mcap"), 99.0, 0.0, 0)
    assert "Replaying from 99 s - 3.95 s (3.95 s) at 1.0x\n" in answer
    assert {vehicle.type_id for vehicle in inside.world.vehicles.actors} == CARS
    inside.world.tick()
    assert not inside.world.replayer.is_playing


def test_a_replay_that_follows_a_missing_actor_runs_without_following(recordings: Path) -> None:
    inside = Inside()
    before = inside.world.spectator.transform
    with pytest.warns(RecapWarning, match="follows no actor: .* no actor 4242 to follow; known ids are"):
        answer = inside.call("replay_file", str(recordings / "drive.mcap"), 0.0, 0.0, 4242)
    assert "Replaying from 0 s - 3.95 s" in answer
    inside.world.tick()
    assert inside.world.replayer.is_playing
    assert inside.world.spectator.transform == before


@pytest.mark.parametrize("how", ["autopilot", "control", "batch", "ackermann"])
def test_a_client_takes_over_a_vehicle_after_a_replay(recordings: Path, how: str) -> None:
    inside = Inside()
    inside.world.replay_file(recordings / "drive.mcap", start=2.0)
    inside.world.run(0.5)
    inside.call("stop_replayer", True)
    inside.world.run(0.1)
    hero = next(vehicle for vehicle in inside.world.vehicles.actors if vehicle.type_id == "vehicle.tesla.model3")
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
    recordings: Path, caplog: pytest.LogCaptureFixture
) -> None:
    inside = Inside()
    for number in range(2):
        inside.call("replay_file", str(recordings / "drive.mcap"), 0.0, 0.0, 0)
        for vehicle in list(inside.world.vehicles.actors):
            inside.call("set_actor_autopilot", vehicle.id, True)
            inside.call("apply_control_to_vehicle", vehicle.id, [0.0, 0.0, 1.0, False, False, False, 0])
        assert caplog.text.count("follows a recording") == number + 1


def test_that_a_recording_ends_another_or_a_replay_is_logged(
    recordings: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    inside = Inside()
    inside.call("start_recorder", str(tmp_path / "first.log"))
    assert not caplog.records
    inside.call("start_recorder", str(tmp_path / "second.log"))
    assert re.search(r"the recording of \S+first\.log ends, since \S+second\.log begins", caplog.text)
    inside.call("replay_file", str(recordings / "drive.mcap"), 0.0, 0.0, 0)
    inside.call("start_recorder", str(tmp_path / "third.log"))
    assert re.search(r"the replay of \S+drive\.mcap ends", caplog.text)
    inside.world.close()


def test_the_spectator_follows_at_an_offset(client: carla.Client, world: carla.World) -> None:
    (id,) = re.findall(r"Create (\d+): vehicle\.tesla", client.show_recorder_file_info("drive", False))
    offsets = (carla.Transform(carla.Location(-10, 0, 5), carla.Rotation(pitch=-25)), carla.Transform(carla.Location(z=40)))
    for offset in offsets:
        arguments = () if offset is offsets[0] else (False, offset)
        client.replay_file("drive", 0.0, 0.0, int(id), *arguments)
        ticks(world, 10)
        car, camera = vehicles(world)["vehicle.tesla.model3"].get_transform(), world.get_spectator().get_transform()
        expected = carla.Transform(car.location, carla.Rotation(yaw=car.rotation.yaw)).transform(offset.location)
        assert camera.location.distance(expected) < 0.01
        assert camera.rotation.pitch == pytest.approx(offset.rotation.pitch, abs=1e-3)


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
def test_the_options_of_older_and_newer_clients_are_accepted(recordings: Path, options: tuple[object, ...]) -> None:
    inside = Inside()
    inside.world.weather = replace(inside.world.weather, cloudiness=77.0)
    answer = inside.call("replay_file", str(recordings / "drive.mcap"), 0.0, 0.0, 0, *options)
    assert "Total time recorded: 3.95\n" in answer
    assert inside.world.weather.cloudiness == (77.0 if options[:2] == (False, False) else 0.0)


def test_a_newer_client_can_name_the_map_of_a_replay_and_other_options_are_errors(recordings: Path) -> None:
    inside = Inside()
    answer = inside.call("replay_file", str(recordings / "nowhere.log"), 0.0, 0.0, 0, False, True, OFFSET, "Brickfield")
    assert "Total time recorded: 0\n" in answer
    for options in ((1,), ("Brickfield", "Brickfield"), (True, True, True), ({},), (OFFSET, OFFSET)):
        with pytest.raises(RecapError, match="replay_file"):
            inside.call("replay_file", str(recordings / "drive.mcap"), 0.0, 0.0, 0, *options)


def test_the_layered_variant_of_the_present_map_is_the_present_map(recordings: Path) -> None:
    host = Host(World(load_town(called="Town05")), stand_in=True)
    replay = [str(recordings / "drive.mcap"), 0.0, 0.0, 0, False, True, OFFSET, "Town05_Opt"]
    assert "Loading map" not in asyncio.run(CALLS["replay_file"](client_inside(host), replay))
    assert host.world.episode.number == 1
    host.close()


def test_a_recording_ends_a_replay_unless_a_newer_client_records_it(recordings: Path, tmp_path: Path) -> None:
    inside = Inside()
    for arguments, goes_on in (((False,), False), ((False, True), False), ((False, False), True)):
        inside.world.replay_file(recordings / "drive.mcap")
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


def test_clients_are_served_while_a_replay_is_opened(recordings: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    host, opening = Host(World(load_town())), Blocked(replayer.open_reader)
    monkeypatch.setattr(replayer, "open_reader", opening)

    async def run() -> str:
        replay = CALLS["replay_file"](client_inside(host), [str(recordings / "drive.mcap"), 0.0, 0.0, 0])
        answer: str
        answer, _ = await asyncio.gather(replay, opening.serve_others(host))
        return answer

    assert "Total time recorded: 3.95\n" in asyncio.run(run())
    assert host.world.replayer.is_playing
    host.close()


@pytest.mark.parametrize("stops", [False, True])
async def test_clients_are_served_while_the_actors_of_a_replay_are_spawned(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, stops: bool
) -> None:
    monkeypatch.setattr(serving_host, "_SLICE", 0.0)
    host = Host(World(load_town(called="Elsewhere")))
    client, other = client_inside(host), client_inside(host)
    present: list[int] = []
    published: list[int] = []
    monkeypatch.setattr(host, "publish", lambda: published.append(len(host.world.vehicles)))
    replay = asyncio.ensure_future(CALLS["replay_file"](client, [str(recordings / "drive.mcap"), 0.0, 0.0, 0]))
    while not host.batches:
        await asyncio.sleep(0)
    while host.batches:
        present.append(len(host.world.vehicles))
        if stops and present[-1] == 1:
            CALLS["stop_replayer"](other, [False])
        await asyncio.sleep(0)
    if stops:
        with pytest.raises(RecapError, match="was stopped before it had begun"):
            await replay
    else:
        assert "Total time recorded: 3.95\n" in await replay
        assert {1, 2} <= set(present)
    assert published == [0 if stops else 2]  # the first snapshot of the episode has all actors
    host.close()


@pytest.mark.parametrize("ending", ["stop_recorder", "start_recorder", "replay_file", "load_new_episode"])
def test_clients_are_served_while_a_recording_is_completed(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    host, path = Host(World(load_town())), tmp_path / "ends.mcap"
    arguments = {
        "stop_recorder": [],
        "start_recorder": [str(tmp_path / "next.mcap"), False],
        "replay_file": [str(recordings / "drive.mcap"), 0.0, 0.0, 0],
        "load_new_episode": ["", True, 0],
    }[ending]

    async def run() -> bytes:
        client = client_inside(host)
        await CALLS["start_recorder"](client, [str(path), False])
        host.tick()
        completing = Blocked(host.world.recorder._writer.close)
        host.world.recorder._finish = completing
        answer = CALLS[ending](client, arguments)
        task = asyncio.ensure_future(answer) if asyncio.iscoroutine(answer) else asyncio.sleep(0)
        await asyncio.gather(task, completing.serve_others(host))
        info: bytes = await CALLS["show_recorder_file_info"](client, [str(path), False])
        return info

    assert b"Frames: 1\n" in asyncio.run(run())
    host.close()


def test_a_recording_that_another_client_begins_while_a_map_is_loaded_is_completed_in_a_thread(tmp_path: Path) -> None:
    host, threads = Host(World(load_town())), []

    async def run() -> None:
        await CALLS["start_recorder"](client := client_inside(host), [str(tmp_path / "ends.mcap"), False])
        finish = host.world.recorder._finish
        assert finish is not None
        host.world.recorder._finish = lambda: threads.append(threading.current_thread()) or finish()
        host.begin_episode(host.world.town, client)
        await host.recordings.completed()

    asyncio.run(run())
    assert len(threads) == 1
    assert threads[0] is not threading.main_thread()
    with carla_recap.open_recording(tmp_path / "ends.mcap") as recording:
        assert not list(recording)
    host.close()


def test_a_recording_that_cannot_be_completed_is_logged_and_others_can_be_asked_about(
    recordings: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    host = Host(World(load_town()))

    def fail() -> None:
        raise OSError("lost")

    async def run() -> bytes:
        client = client_inside(host)
        await CALLS["start_recorder"](client, [str(tmp_path / "ends.mcap"), False])
        host.tick()
        writer = host.world.recorder._writer
        host.world.recorder._finish = fail
        CALLS["stop_recorder"](client, [])
        writer.close()
        info: bytes = await CALLS["show_recorder_file_info"](client, [str(recordings / "drive.mcap"), False])
        return info

    assert b"Frames: 80\n" in asyncio.run(run())
    assert "a recording could not be completed: lost" in caplog.messages
    host.close()


@pytest.mark.parametrize("step", ["maps.preload", "between_batches"])
def test_a_replay_that_cannot_begin_leaves_no_file_open(
    recordings: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    host, opened = Host(World(load_town())), []

    def note(*about: Any) -> Any:
        opened.append(reader := open_reader(*about))
        return reader

    async def fail(*about: Any) -> None:
        raise RecapError("no memory")

    monkeypatch.setattr(replayer, "open_reader", note)
    *owner, name = step.split(".")
    monkeypatch.setattr(host.maps if owner else host, name, fail)

    async def run() -> None:
        await CALLS["replay_file"](client_inside(host), [str(recordings / "drive.mcap"), 0.0, 0.0, 0])

    with pytest.raises(RecapError, match="no memory"):
        asyncio.run(run())
    with pytest.raises(Closed):
        opened[0].check_open()
    host.close()


# --- confined ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def confined(recordings: Path) -> Iterator[carla.Client]:
    with running(recordings=recordings, confine=True) as port:
        client = connect(port)
        yield client


def test_a_confined_server_serves_its_folder(confined: carla.Client, recordings: Path) -> None:
    for name in ("drive", "also.log", str(recordings / "drive.mcap")):
        assert "Brickfield" in confined.show_recorder_file_info(name, False)
        assert "Total time recorded" in confined.replay_file(name, 0.0, 0.0, 0)
    assert confined.start_recorder(f"{recordings}/own.log") == str(recordings / "own.log")
    confined.stop_recorder()
    confined.get_server_version()
    assert (recordings / "own.log").exists()


def test_a_confined_server_keeps_to_its_folder(confined: carla.Client, recordings: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside.log"
    outside.write_bytes((recordings / "also.log").read_bytes())
    (recordings / "link.log").symlink_to(outside)
    (recordings / "links").symlink_to(tmp_path)
    (recordings / "loop.log").symlink_to(recordings / "loop.log")
    names = [str(outside), f"{recordings}/../{tmp_path.name}/x.log", "link", "link.log", f"{recordings}/links/outside.log"]
    for name in [*names, ".", "..", "../x", "loop.log"]:
        calls = [*queries_of(name), lambda client, name=name: client.replay_file(name, 0.0, 0.0, 0)]
        if name != "link":  # a new link.mcap is as good as any
            calls.append(lambda client, name=name: client.start_recorder(name))
        for ask in calls:
            with pytest.raises(RuntimeError, match="is outside the folder of recordings"):
                ask(confined)
