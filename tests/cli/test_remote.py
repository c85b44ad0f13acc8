"""Commands on recordings at URLs, and on moments of recordings: SRC#t=12.1."""

from __future__ import annotations

import shutil
import signal
import subprocess
import time

import pytest

from carla_recap import open_recording
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, answer, run, wrote
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
    ("#t=53.05",): (48.05, 53),  # as printed of a moment at its end, rounded
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
