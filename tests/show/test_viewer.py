"""The viewer, served to a browser, and without a display."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

import pytest

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")

import psutil

from carla_recap import open_recording
from carla_recap.errors import RecapError
from carla_recap.show.rerun.viewer import view
from tests.samples import CROSSING
from tests.screenshots import ScreenshotTaker
from tests.waiting import PATIENCE, time_limit, wait_until

SERVE = """
import sys
from carla_recap import open_recording
from carla_recap.show.rerun.viewer import view
with open_recording(sys.argv[1]) as recording:
    view(recording, web=True, web_port=int(sys.argv[2]), start=20, duration=6, ready=lambda url: print(url, flush=True))
"""


@pytest.fixture
def served(temporary):
    """The process that serves the crossing, and the address that it gave, whose port was asked for."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-c", SERVE, CROSSING, str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            url = process.stdout.readline().strip()
            assert urlsplit(url).port == port
            yield process, url
        finally:
            process.terminate()


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
def test_a_browser_is_served_until_it_is_interrupted(served):
    process, url = served
    children = psutil.Process(process.pid).children()
    assert urlsplit(url).hostname == "127.0.0.1"
    with urlopen(url, timeout=PATIENCE) as page:
        assert page.headers["Content-Type"].startswith("text/html")
        assert b"re_viewer" in page.read()
    with urlopen(url.partition("?")[0] + "re_viewer_bg.wasm", timeout=PATIENCE) as program:
        assert program.read(4) == b"\0asm"
    sockets = [each for child in children for each in child.net_connections("inet")]
    assert {each.laddr.ip for each in sockets} == {"127.0.0.1"}
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 0
    assert process.stderr.read() == ""
    assert not [child for child in children if child.is_running()]


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
def test_a_closed_terminal_ends_the_viewer(served):
    process, _ = served
    children = psutil.Process(process.pid).children()
    process.send_signal(signal.SIGHUP)
    assert process.wait(PATIENCE) == 128 + signal.SIGHUP
    assert children
    assert not [child for child in children if child.is_running()]


def test_the_browser_gets_the_recording(served, crossing_rrd):
    (source,) = parse_qs(urlsplit(served[1]).query)["url"]
    with ScreenshotTaker(source) as screenshots:
        wait_until(lambda: _times(screenshots) == (20_000_000_000, 26_000_000_000))


def _times(screenshots: ScreenshotTaker) -> tuple[int, int] | None:
    """Return the first and the last time of the data that the viewer has received so far, in ns."""
    timelines = [timeline for recording in screenshots.state.recordings for timeline in recording.timelines]
    return next(((timeline.start, timeline.end) for timeline in timelines if timeline.name == "sim_time"), None)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays are named so on Linux")
@pytest.mark.parametrize(
    ("display", "options", "message"),
    [
        (None, {"follow": 777}, "no actor 777 to follow"),
        (None, {}, r"no display .* --web serves it"),
        (":4711", {"start": 20, "duration": 1}, r"exit code 1: Failed to open"),
    ],
)
def test_a_window_that_does_not_open_is_an_error(temporary, monkeypatch, display, options, message):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    if display:
        monkeypatch.setenv("DISPLAY", display)
    with open_recording(CROSSING) as recording, time_limit(), pytest.raises(RecapError, match=message):
        view(recording, **options)
