"""Foxglove's connection over a WebSocket: a client of the real protocol plays a recording and watches a running world."""

from __future__ import annotations

import math
import os
import signal
import struct
import subprocess
import sys
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from socket import create_connection
from types import SimpleNamespace
from typing import Any, Final

import pytest
from click.testing import CliRunner

from carla_recap import MissingExtra, RecapError, clip, export, open_recording
from carla_recap.cli.capture import watch
from carla_recap.cli.export import view
from tests.cli.command import COMMAND, ENVIRONMENT, error
from tests.samples import CRASH, CROSSING
from tests.waiting import PATIENCE

pytest.importorskip("foxglove", reason="the extra foxglove-live is not installed")
pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")
pytest.importorskip("tornado", reason="tornado is not installed")

from foxglove.websocket import PlaybackCommand
from mcap.reader import make_reader

from carla_recap.show.foxglove.topics import TOPICS
from carla_recap.show.foxglove.websocket import FoxgloveServer, FoxgloveView, Timeline
from tests.show.foxglove_client import Viewer, connected, decoded
from tests.show.foxglove_reader import raw

SECOND: Final = 10**9
PLAY, PAUSE = 0, 1
PLAYING, PAUSED, ENDED = 0, 1, 3
STILL: Final = {
    "/map",
    "/scene/vehicles",
    "/scene/walkers",
    "/scene/others",
    "/scene/lamps",
    "/scene/signals",
    "/scene/marks",
}


@contextmanager
def viewing(*arguments: object) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    command = [COMMAND, "view", *map(str, arguments), "--foxglove", "--foxglove-port", "0"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=ENVIRONMENT) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip(), process
        finally:
            process.kill()


@pytest.fixture(scope="module")
def served() -> Iterator[str]:
    """The address of a recording that is served."""
    with viewing(CROSSING) as (address, _):
        yield address


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "crossing.mcap"
    with open_recording(CROSSING) as recording:
        export(recording, path, to="foxglove")
    return path


@pytest.fixture
def viewer(served: str) -> Iterator[Viewer]:
    """A viewer of it, which has sought its beginning."""
    with connected(served) as found:
        found.control(PAUSE, seek=start_of(found), id="begin")
        found.receive(lambda: {topic for topic, time, _ in found.messages if time == start_of(found)} >= {*STILL, "/lights"})
        found.messages.clear()
        yield found


def start_of(viewer: Viewer) -> int:
    return moment(viewer.info["dataStartTime"])


def moment(time: dict[str, int]) -> int:
    return time["sec"] * SECOND + time["nsec"]


def test_the_topics_are_those_of_an_export(viewer: Viewer, exported: Path) -> None:
    with exported.open("rb") as file:
        summary = make_reader(file).get_summary()
    expected = {
        channel.topic: (summary.schemas[channel.schema_id].name, summary.schemas[channel.schema_id].data)
        for channel in summary.channels.values()
    }
    assert {
        topic: (channel["schemaName"], b64decode(channel["schema"])) for topic, channel in viewer.channels.items()
    } == expected
    assert viewer.info["capabilities"] == ["time", "playbackControl"]
    assert moment(viewer.info["dataEndTime"]) - start_of(viewer) == 53 * SECOND


def test_a_viewer_gets_the_latest_messages_and_the_state(served: str, viewer: Viewer) -> None:
    with connected(served) as other:
        other.latest(*STILL)
        other.receive(lambda: other.states)
        assert other.states[0] == (PAUSED, start_of(viewer), 1.0, "")
        assert {time for _, time, _ in other.messages} == {start_of(viewer)}


def test_a_walker_that_has_fallen_long_ago_lies_where_it_is_sought(tmp_path: Path) -> None:
    crash, path = tmp_path / "crash.mcap", tmp_path / "shown.mcap"
    clip(CRASH, crash, start=10.0, duration=15.0)
    with open_recording(crash) as recording:
        export(recording, path, to="foxglove")
        (hit, *_) = (row for row in recording.collisions() if "w" in (row.letter1, row.letter2))
    with viewing(crash) as (address, _), connected(address) as viewer:
        for second in (hit.elapsed + 5.5, 14.0):  # with the mark of the collision, and without
            compare(viewer, path, second)


@pytest.mark.parametrize("second", [0, 24.7, 53])
def test_a_moment_that_is_sought_looks_as_in_an_export(viewer: Viewer, exported: Path, second: float) -> None:
    compare(viewer, exported, second)


def compare(viewer: Viewer, exported: Path, second: float) -> None:
    """Compare what is shown of a moment that is sought with the latest messages of an export."""
    viewer.messages.clear()
    at = start_of(viewer) + round(second * SECOND)
    state = viewer.control(PAUSE, seek=at)
    assert state == (PAUSED, at, 1.0, "me")
    viewer.receive(lambda: {topic for topic, time, _ in viewer.messages if time > at - SECOND // 7} >= {"/tf", "/hero"})
    found = viewer.latest(*STILL, "/tf/still", "/lights", *(["/tf/actors"] if second else []))
    expected = {topic: found[-1][1] for topic, found in raw(exported, stop=at + 1).items()}
    for topic in STILL:
        assert entities(viewer, topic, found[topic]) == entities(viewer, topic, expected[topic]), topic
    assert frames(viewer, found) == {name: pytest.approx(pose, abs=0.6) for name, pose in frames(viewer, expected).items()}
    light, other = (decoded(viewer, "/lights", each["/lights"]) for each in (found, expected))
    assert (light.ahead.text, len(light.lights)) == (other.ahead.text, len(other.lights))


def entities(viewer: Viewer, topic: str, data: bytes) -> dict[str, str]:
    """Return the entities of a message, without their times."""
    found = {}
    for entity in decoded(viewer, topic, data).entities:
        entity.ClearField("timestamp")
        found[entity.id] = str(entity)
    return found


def frames(viewer: Viewer, latest: dict[str, bytes]) -> dict[str, list[float]]:
    """Return the positions of all frames."""
    topics = [topic for topic in ("/tf", "/tf/still", "/tf/actors") if topic in latest]
    transforms = [each for topic in topics for each in decoded(viewer, topic, latest[topic]).transforms]
    return {
        each.child_frame_id: [each.translation.x, each.translation.y, each.translation.z]
        for each in transforms
        if each.child_frame_id != "followed"  # its heading is calm, and depends on where playback began
    }


def test_time_passes_while_it_plays_as_fast_as_was_asked_for(viewer: Viewer) -> None:
    assert viewer.control(PLAY, 8.0)[::2] == (PLAYING, 8.0)
    viewer.receive(lambda: viewer.messages and viewer.messages[-1][1] >= start_of(viewer) + 4 * SECOND)
    status, paused, *_ = viewer.control(PAUSE, 8.0, id="pause")
    assert status == PAUSED
    assert paused >= start_of(viewer) + 4 * SECOND
    assert viewer.control(PLAY, 1.0, id="again")[1] == paused
    times = [time for _, time, _ in viewer.messages]
    assert times == sorted(times)
    assert {"/hero", "/tf", "/tf/actors"} <= {topic for topic, _, _ in viewer.messages}


def test_viewers_have_one_timeline(served: str, viewer: Viewer) -> None:
    with connected(served) as other:
        other.receive(lambda: other.states)
        viewer.control(PAUSE, 3.0, seek=start_of(viewer) + SECOND, id="the first one")
        other.receive(lambda: other.time == start_of(viewer) + SECOND)
        assert other.states[-1] == (PAUSED, start_of(viewer) + SECOND, 3.0, "the first one")


def test_it_ends_and_begins_again(viewer: Viewer) -> None:
    stop = moment(viewer.info["dataEndTime"])
    viewer.control(PLAY, seek=stop - SECOND // 5)
    viewer.receive(lambda: any(state[0] == ENDED for state in viewer.states))
    assert (ENDED, stop, 1.0, "") in viewer.states
    viewer.receive(lambda: viewer.messages and viewer.messages[-1][1] == stop)
    assert viewer.control(PLAY, id="again")[:2] == (PLAYING, start_of(viewer))


def test_incidents_are_in_the_log(viewer: Viewer) -> None:
    viewer.control(PLAY, 4.0, seek=start_of(viewer) + 20 * SECOND)
    texts = []

    def is_there() -> bool:
        texts[:] = [decoded(viewer, topic, data).message for topic, _, data in viewer.messages if topic == "/log"]
        return any("collides with" in text for text in texts) and any("brakes" in text for text in texts)

    viewer.receive(is_there)


def test_nonsense_ends_nothing(served: str) -> None:
    with connected(served) as viewer:
        for data in (b"", b"\x03", b"\xff" * 30, "{", '{"op":"subscribe","subscriptions":[{"id":1,"channelId":99999}]}'):
            viewer._send(data)
        for seek in (0, (1 << 64) - 1):
            viewer._send(struct.pack("<BBfBQI", 3, PLAY, math.nan, True, seek, 0))
    with connected(served) as viewer:
        for seek, found in ((1 << 63, moment(viewer.info["dataEndTime"])), (0, start_of(viewer))):
            assert viewer.control(PAUSE, seek=seek)[:2] == (PAUSED, found)


def test_ctrl_c_ends_it_while_a_viewer_does_not_read_and_another_one_says_nothing() -> None:
    with viewing(CROSSING) as (address, process), connected(address) as viewer:
        host, _, port = address.removeprefix("ws://").partition(":")
        with create_connection((host, int(port)), PATIENCE):
            viewer.control(PLAY, 100.0)
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0
        assert process.stderr is not None
        said = process.stderr.read().splitlines()
    assert [line.partition(":")[0] for line in said] == [
        "the layout for Foxglove",
        "Lichtblick and Foxglove 1.x cannot connect; they open what 'carla-recap export --to foxglove' writes",
        "Ctrl-C ends it",
    ]


def test_a_recording_that_is_cut_while_it_plays_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "cut.log"
    path.write_bytes(CROSSING.read_bytes())
    with viewing(path) as (address, process), connected(address) as viewer:
        os.truncate(path, 0)
        viewer.request(PLAY, seek=start_of(viewer) + 40 * SECOND)
        assert process.wait(PATIENCE) == 2
        assert process.stderr is not None
        said = process.stderr.read().splitlines()
    assert "cut.log: byte " in said[-1]
    assert said[-1].endswith("the file has become shorter while it was read")
    assert len(said) == 4


def test_wrong_arguments_are_errors() -> None:
    for command, option, *further in (
        (view, "--web", str(CROSSING)),
        (view, "--view", "top", str(CROSSING)),
        (watch, "--to", "out.rrd"),
    ):
        done = CliRunner().invoke(command, ["--foxglove", option, *further])
        assert (done.exit_code, f"{option} goes with Rerun's viewer" in done.output) == (2, True)
    assert "no actor 7 to follow" in error("view", CROSSING, "--foxglove", "--follow", "7")


def test_a_port_in_use_is_an_error() -> None:
    with FoxgloveServer("first", 0) as server:
        port = int(server.address.rpartition(":")[2])
        with pytest.raises(RecapError, match=f"^127.0.0.1:{port}: Foxglove cannot connect to it: Address already in use$"):
            FoxgloveServer("second", port)


def test_the_missing_extra_is_named() -> None:
    code = "import sys; sys.modules['foxglove'] = None; from carla_recap.cli import main; main()"
    command = [sys.executable, "-c", code, "view", CROSSING, "--foxglove"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 2
    assert done.stderr == f"carla-recap: {MissingExtra('carla-recap view', 'foxglove-live')}\n"


# --- sensors -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sensor_topics(sensed_recording: Path) -> list[str]:
    with open_recording(sensed_recording) as recording:
        return [name for name in recording.reader.further_topics() if name not in {topic.name for topic in TOPICS}]


@pytest.fixture(scope="module")
def served_sensors(sensed_recording: Path) -> Iterator[str]:
    """The address of a recording with sensors that is served."""
    with viewing(sensed_recording) as (address, _):
        yield address


def begin_at(viewer: Viewer, time: int) -> None:
    """Seek a time, and wait until all that the server sends there has come: another test may have left it playing."""
    begin = start_of(viewer)
    viewer.control(PAUSE, seek=begin)
    viewer.receive(lambda: {topic for topic, at, _ in viewer.messages if at == begin} >= STILL)
    viewer.messages.clear()
    viewer.control(PAUSE, seek=time)
    viewer.receive(lambda: viewer.messages and viewer.time == time)
    viewer.messages.clear()


def test_the_latest_data_of_each_sensor_are_those_of_the_moment_that_is_sought(
    served_sensors: str, sensed_recording: Path, sensor_topics: list[str]
) -> None:
    with connected(served_sensors, len(sensor_topics)) as viewer:
        at = start_of(viewer) + round(11.72 * SECOND)
        found = raw(sensed_recording, stop=at + 1)
        expected = {topic: found[topic][-1] for topic in sensor_topics}
        viewer.control(PAUSE, seek=at)
        viewer.receive(lambda: set(expected) <= {topic for topic, time, _ in viewer.messages if time > at - SECOND // 7})
        viewer.receive(lambda: viewer.time == at)
        assert {topic: (time, data) for topic, time, data in viewer.messages if topic in expected} == expected


def test_all_data_of_sensors_come_while_it_plays(
    served_sensors: str, sensed_recording: Path, sensor_topics: list[str]
) -> None:
    with connected(served_sensors, len(sensor_topics)) as viewer:
        start, stop = (start_of(viewer) + round(seconds * SECOND) for seconds in (11.72, 12.32))
        begin_at(viewer, start)
        viewer.control(PLAY)
        viewer.receive(lambda: viewer.messages and viewer.messages[-1][1] > stop)  # the time comes before the messages
        played: dict[str, list[tuple[int, bytes]]] = {}
        for topic, time, data in viewer.messages:
            if topic in sensor_topics and start < time < stop:
                played.setdefault(topic, []).append((time, data))
        stored = raw(sensed_recording, start + 1, stop)
        assert played == {topic: stored[topic] for topic in sensor_topics if topic in stored}
        image = decoded(viewer, "/sensors/front/image", played["/sensors/front/image"][0][1])
        assert (image.format, image.frame_id) == ("jpeg", "front")


# --- the timeline ------------------------------------------------------------------------------------------------


def request(play: bool, speed: float = 1.0, seek: int | None = None) -> Any:
    command = PlaybackCommand.Play if play else PlaybackCommand.Pause
    return SimpleNamespace(playback_command=command, playback_speed=speed, seek_time=seek, request_id="me")


def test_the_time_before_a_moment_is_sought_does_not_count() -> None:
    timeline = Timeline(0, 10 * SECOND)
    assert timeline.advance(0.0) == (0, True)
    timeline.request(request(play=True, seek=5 * SECOND))
    assert timeline.advance(0.25) == (5 * SECOND, True)
    assert timeline.advance(0.25) == (5.25 * SECOND, False)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_speed_that_is_none_is_ignored(speed: float) -> None:
    timeline = Timeline(0, SECOND)
    assert timeline.request(request(play=True, speed=speed)).playback_speed == 1.0


# --- a running world -----------------------------------------------------------------------------------------------


def test_frames_are_shown_as_they_come() -> None:
    with open_recording(CROSSING) as recording, FoxgloveServer("live", 0) as server:
        view = FoxgloveView(server, recording.header)
        frames = recording.frames(stop=3.0)
        view.enter(next(frames))
        with connected(server.address) as viewer:
            viewer.receive(lambda: {topic for topic, _, _ in viewer.messages} >= STILL, view.flush)
            assert viewer.info["capabilities"] == ["time"]
            viewer.receive(lambda: viewer.time)
            assert viewer.time == max(time for _, time, _ in viewer.messages)
            for frame in frames:
                view.enter(frame)
            view.close()
            hero = decoded(viewer, "/hero", viewer.latest("/hero", "/tf/actors")["/hero"])
        with connected(server.address) as late:
            late.receive(lambda: {topic for topic, _, _ in late.messages} >= {*STILL, "/lights"}, view.flush)
    assert hero.type_id == "vehicle.tesla.model3"
