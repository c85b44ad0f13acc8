"""Commands on recordings at URLs, and on moments of recordings: SRC#t=12.1."""

from __future__ import annotations

import shutil
import signal
import subprocess
import time

import pytest

from carla_recap import open_recording
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, answer, error, run, wrote
from tests.waiting import PATIENCE

web = pytest.importorskip("tests.web", reason="the extra `remote` is not installed")


@pytest.fixture
def served(tmp_path):
    (tmp_path / "served").mkdir()
    shutil.copy(CROSSING, tmp_path / "served")
    with web.serve(tmp_path / "served") as server:
        yield f"{server.url}/{CROSSING.name}"


@pytest.mark.parametrize(("name", "form"), [("info", "--text"), ("incidents", "--json")])
def test_a_query_of_a_url_answers_as_of_the_file(served, name, form):
    assert answer(name, served, form).replace(served, str(CROSSING)) == answer(name, CROSSING, form)


def test_clips_are_not_written_to_a_url():
    expected = "s3://bucket/out: is a URL; a path was expected, since only files of this machine are written"
    assert error("clips", CROSSING, "s3://bucket/out") == expected


def test_ctrl_c_does_not_wait_for_a_server(tmp_path):
    with web.serve(tmp_path) as server:
        server.delay = 600
        command = [COMMAND, "collisions", f"{server.url}/x.mcap"]
        with subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            while not server.requests and process.poll() is None:
                time.sleep(0.01)
            process.send_signal(signal.SIGINT)
            _, messages = process.communicate(timeout=PATIENCE)
    assert (process.returncode, messages.strip()) == (130, b"")


CLIPS = {
    ("#t=20.5",): (15.5, 25.5),
    ("#t=2",): (0, 7),
    ("#t=20,21.5",): (20, 21.5),
    ("#t=20", "--duration", "3"): (15, 18),
    ("#t=20", "--start", "1", "--duration", "2"): (1, 3),
}


@pytest.mark.parametrize("arguments", CLIPS)
def test_a_clip_of_a_moment(tmp_path, arguments):
    fragment, *options = arguments
    begin, end = CLIPS[arguments]
    assert run("clip", f"{CROSSING}{fragment}", tmp_path / "clip.log", *options).returncode == 0
    with open_recording(tmp_path / "clip.log") as recording:
        assert recording.info.duration == pytest.approx(end - begin, abs=0.2)
        (found,) = recording.frames(stop=0.05)
    with open_recording(CROSSING) as recording:
        expected = recording.frame_at(begin)
    assert found["transforms"].tolist() == expected["transforms"].tolist()


def test_an_export_of_a_moment(served, tmp_path):
    done = run("export", f"{served}#t=20", tmp_path / "tracks.csv")
    assert wrote(done.stderr) == [f"{tmp_path}/tracks.csv: 101 frames, 10 s"]


def test_a_span_that_ends_before_it_begins(tmp_path):
    assert error("clip", f"{CROSSING}#t=20,10", tmp_path / "x.log") == f"{CROSSING}#t=20,10: an end after 20 s was expected"


def test_a_picture_needs_a_moment(tmp_path):
    assert error("snapshot", CROSSING, tmp_path / "x.png").startswith("Missing option '--at'. SRC#t=S says it, too.")


@pytest.mark.parametrize("text", ["abc", "", "-1", "1,x"])
def test_what_is_no_time_is_said_to_be_none(tmp_path, text):
    source = f"{CROSSING}#t={text}"
    expected = f"{source}: {text!r} is no time; seconds were expected, such as #t=12.1, or #t=12.1,20"
    assert error("clip", source, tmp_path / "out.mcap") == expected
    assert error("snapshot", source, tmp_path / "out.png") == expected


def test_a_moment_after_the_end_is_named_as_it_was_given(tmp_path):
    for time_asked in (56, 99):  # 5 s before the first one is in the recording
        message = error("clip", f"{CROSSING}#t={time_asked}", tmp_path / "out.mcap")
        assert message == f"{CROSSING}: nothing at {time_asked} s; the recording ends at 53 s"
    assert run("clip", f"{CROSSING}#t=53.05", tmp_path / "out.mcap").returncode == 0
