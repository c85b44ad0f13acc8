"""The importer as the viewer runs it: a program that takes a file, and answers on stdout."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")

from mcap.writer import Writer
from rerun.chunk import RrdReader

from carla_recap import convert
from carla_recap.show.rerun.importer import FAILED, NOT_OURS
from tests.samples import CROSSING, log_header, save
from tests.screenshots import ScreenshotTaker
from tests.waiting import PATIENCE, time_limit

NAME = "rerun-importer-carla-recap"
RUN = "import sys; from carla_recap.show.rerun.importer import main; main()"


def run(path: Path | str, *options: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-c", RUN, path, *options], capture_output=True, timeout=PATIENCE, env={**os.environ, **environment}
    )


def stores(path: Path, data: bytes) -> list[tuple[str, str]]:
    """The application and the recording of each store in an .rrd."""
    reader = RrdReader(save(path, data))
    return [(store.application_id, store.recording_id) for store in (*reader.recordings(), *reader.blueprints())]


def damaged_mcap(path: Path) -> bytes:
    convert(CROSSING, path)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 200] = bytes(200)
    return bytes(data)


def foreign_mcap(library: str) -> bytes:
    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library=library)
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize("suffix", [".mcap", ".anything"])
def test_recordings_are_recognized_by_their_content(tmp_path, small, suffix):
    path = tmp_path / f"a recording{suffix}"
    if suffix == ".mcap":
        convert(small, path)
    else:
        small.rename(path)
    done = run(path, "--application-id", "some app", "--recording-id", "some id", "--unheard-of", "--timeless")
    assert (done.returncode, done.stderr) == (0, b"")
    reader = RrdReader(save(tmp_path / "out.rrd", done.stdout))
    assert "/world/actors/7" in reader.store().schema().entity_paths()
    assert set(stores(tmp_path / "out.rrd", done.stdout)[:1]) == {("some app", "some id")}
    assert stores(tmp_path / "out.rrd", done.stdout)[1][0] == "some app"


@pytest.mark.parametrize(
    "content",
    [b"a server's log\n" * 100, foreign_mcap("after carla_recap.header"), b"\x89MCAP0\r\n", ".", os.devnull, "\udcff.log"],
    ids=["text", "foreign mcap", "cut mcap", "folder", "device", "missing"],
)
def test_other_files_are_left_to_other_importers(tmp_path, content):
    done = run(save(tmp_path / "file.log", content) if isinstance(content, bytes) else content)
    assert (done.returncode, done.stdout, done.stderr) == (NOT_OURS, b"", b"")


def test_other_files_cause_no_slow_imports(tmp_path):
    check = f"import sys; sys.argv[1:] = [{str(save(tmp_path / 'file.log', b'text'))!r}]; import atexit; " + (
        "atexit.register(lambda: print({'numpy', 'rerun', 'mcap', 'google.protobuf'} & set(sys.modules))); " + RUN
    )
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout) == (NOT_OURS, b"set()\n")


@pytest.mark.parametrize(("name", "content"), [("no frames", log_header()), ("damaged", None)])
def test_a_damaged_recording_is_an_error_of_one_line(tmp_path, name, content):
    path = save(tmp_path / f"{name}\n.mcap", content if content is not None else damaged_mcap(tmp_path / "whole.mcap"))
    done = run(path)
    assert done.returncode == FAILED
    (line,) = done.stderr.decode().splitlines()
    assert line.startswith(f"{NAME}: {tmp_path}/{name}")


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
def test_it_ends_when_the_viewer_has_ended():
    command = [sys.executable, "-c", RUN, CROSSING]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        try:
            assert process.wait(PATIENCE) == -signal.SIGPIPE
            assert process.stderr.read() == b""
        finally:
            process.kill()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_destination_is_an_error_of_one_line(small):
    command = [sys.executable, "-c", RUN, small]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, timeout=PATIENCE)
    line = f"{NAME}: stdout: cannot be written: No space left on device\n"
    assert (done.returncode, done.stderr.decode()) == (FAILED, line)


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
def test_an_interruption_prints_nothing():
    command = [sys.executable, "-c", RUN, CROSSING]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout.read(4)  # it has begun to send
            process.send_signal(signal.SIGINT)
            process.stdout.read()
            assert process.wait(PATIENCE) in (-signal.SIGINT, 0)
            assert process.stderr.read() == b""
        finally:
            process.kill()


@pytest.fixture
def viewer_path(crossing_rrd, monkeypatch):
    """A PATH on which the viewer finds the importer."""
    scripts = Path(sysconfig.get_path("scripts"))
    if not (scripts / NAME).exists():
        pytest.skip(f"{NAME} is not installed: pip install -e .")
    monkeypatch.setenv("PATH", os.pathsep.join((str(scripts), os.environ["PATH"])))


@contextmanager
def opened(path: Path, seconds: float) -> Iterator[ScreenshotTaker]:
    """The viewer, once it has all of a recording that ends after some seconds."""
    with ScreenshotTaker(path) as screenshots:

        def complete() -> bool:
            timelines = [timeline for recording in screenshots.state.recordings for timeline in recording.timelines]
            return ("sim_time", round(seconds * 1e9)) in [(timeline.name, timeline.end) for timeline in timelines]

        with time_limit():
            screenshots._process.wait_for(f"{seconds} s", complete)
        yield screenshots


def test_the_viewer_opens_a_log(viewer_path):
    with opened(CROSSING, 53) as screenshots:
        state = screenshots.state
    assert len(state.recordings) == 1
    assert {"Chase", "Top", "Map", "Events"} <= {view.name for view in state.views}
    assert not [report for view in state.views for report in view.reports]
