"""The commands that export, show and cut recordings."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import urllib.request

import pytest
from click.testing import CliRunner

from carla_recap import Player, open_recording
from carla_recap.cli import progress
from carla_recap.cli.export import view
from carla_recap.cli.opening import printed
from carla_recap.model.frame import LAST_FRAME_DURATION
from carla_recap.output.text import local_date
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, before_others, error, run, the_line, wrote
from tests.queries.conftest import write
from tests.samples import ROOT, reading
from tests.waiting import PATIENCE

rerun = pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
REAL = "carla-0.9.13-lane-center.log"


def said(*arguments: object) -> str:
    """Run a command that succeeds; return its messages on stderr."""
    done = run(*arguments)
    assert (done.returncode, done.stdout) == (0, b""), done.stderr
    return done.stderr.decode()


def test_scenes_are_counted_from_the_first_one_that_is_played(monkeypatch):
    monkeypatch.setattr(progress, "_bar", lambda scenes, _, total, at: [at(scene) / total for scene in scenes])
    with open_recording(CROSSING) as recording:
        player = Player(recording, start=10, duration=2)
        shares = list(progress.watch("exporting")(player.scenes(), player))
    assert (shares[0], shares[-1]) == pytest.approx((0, 1))


# --- export ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("out.rrd", ("--follow", "101")),
        ("out.mcap", ("--to", "foxglove", "--follow", "hero")),
        ("out.rrd", ("--rules", ROOT / "samples" / "rules.toml")),
        ("tracks.csv", ()),
    ],
)
def test_an_export_says_how_much_it_wrote(tmp_path, name, options):
    done = run("export", CROSSING, tmp_path / name, "--start", "-20", "--duration", "2", *options, "--json")
    assert done.returncode == 0
    assert wrote(done.stderr) == [f"{tmp_path / name}: 21 frames, 2 s"]
    (written,) = json.loads(done.stdout)["written"]
    assert (written["path"], written["frames"]) == (str(tmp_path / name), 21)
    assert written["bytes"] == (tmp_path / name).stat().st_size > 1000
    assert done.stderr.startswith(b"the layout for Foxglove: ") == ("foxglove" in options)


def test_an_export_of_files_counts_them(tmp_path):
    pytest.importorskip("pyarrow", reason="the extra `arrow` is not installed")
    done = run("export", CROSSING, tmp_path / "out", "--to", "parquet")
    count = len(list((tmp_path / "out").iterdir()))
    assert wrote(done.stderr) == [f"{tmp_path / 'out'}: 531 frames, 53 s, {count} files"]
    assert "out: is not empty; --force writes over" in error("export", CROSSING, tmp_path / "out", "--to", "parquet")


# --- clips -----------------------------------------------------------------------------------------------------


def test_clips(tmp_path):
    words = said("clips", CROSSING, tmp_path / "clips", "--kinds", "collision", "--before", "1", "--after", "1")
    names = sorted(path.name for path in (tmp_path / "clips").iterdir())
    assert names == [
        f"{name}{suffix}"
        for name in ("01-collision-20.9s-105-110", "02-collision-24.6s-100-101")
        for suffix in (".mcap", ".rrd")
    ]
    assert "collides with walker.pedestrian.0004 (110)" in words
    with reading(tmp_path / "clips" / names[0]) as reader:
        assert reader.extent().duration == pytest.approx(2.8, abs=0.2)
    assert "is not empty" in error("clips", CROSSING, tmp_path / "clips")


def test_clips_with_videos(tmp_path):
    pytest.importorskip("av", reason="the extra video is not installed")
    words = ["--kinds", "collision", "--before", "0.1", "--after", "0.1", "--no-rrd", "--video"]
    said("clips", CROSSING, tmp_path / "clips", *words)
    assert sorted(path.suffix for path in (tmp_path / "clips").iterdir()) == [".mcap", ".mcap", ".mp4", ".mp4"]


@pytest.mark.parametrize("option", [None, "--rrd"])
def test_clips_need_no_rerun(tmp_path, option):
    (tmp_path / "rerun.py").write_text("raise ImportError('no rerun here')")
    environment = ENVIRONMENT | {"PYTHONPATH": before_others(tmp_path)}
    command = [COMMAND, "clips", CROSSING, tmp_path / "clips", *filter(None, [option])]
    done = subprocess.run(command, env=environment, capture_output=True, timeout=PATIENCE, check=False)
    if option == "--rrd":
        assert done.returncode == 2
        assert "pip install '.[rerun]'" in the_line(done.stderr)
        return
    assert done.returncode == 0
    assert b"pip" not in done.stderr
    assert {path.suffix for path in (tmp_path / "clips").iterdir()} == {".mcap"}


# --- pictures, the page, the viewer ----------------------------------------------------------------------------


def test_a_picture_at_a_time_of_a_text_is_of_the_frame_whose_time_it_rounds(tmp_path):
    path = write(tmp_path / "out.log", [{}] * 4, durations=[0.86, 0.0042, 0.5, LAST_FRAME_DURATION])
    with reading(path) as reader:
        found = [printed(reader, time) for time in (0.86, 1.36, 1.361, -1.0)]
    assert found == pytest.approx([0.86, 1.3642, 1.361, -1.0])


def test_the_port_of_the_web_viewer_is_the_one_that_is_asked_for(monkeypatch):
    given = []
    monkeypatch.setattr("carla_recap.show.rerun.viewer.view", lambda _, **how: given.append((how["web"], how["web_port"])))
    for options in ((), ("--web",), ("--web-port", "4321")):
        assert CliRunner().invoke(view, [str(CROSSING), *options]).exit_code == 0
    assert given == [(False, 0), (True, 0), (True, 4321)]


def test_report(tmp_path):
    page = tmp_path / "page"
    _, line = said("report", CROSSING, page).splitlines()
    assert line.startswith(f"wrote {page / 'index.html'}: 4 incidents, ")
    assert (page / "index.html").is_file()
    assert "is not empty" in error("report", CROSSING, page)


def test_a_report_as_one_file(tmp_path):
    page = tmp_path / "page.html"
    warning, line = said("report", CROSSING, page).splitlines()
    assert line.startswith(f"wrote {page}: 4 incidents, ")
    assert "the map 'Crossing' is unknown; rules of the road are left out; --map" in warning
    assert "exists already; --force" in error("report", CROSSING, page)
    *_, line = said("report", CROSSING, page, "--compare", CROSSING, "--force").splitlines()
    assert line.startswith(f"wrote {page}: 8 incidents, ")


def test_the_page_is_served_until_it_is_interrupted(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [COMMAND, "report", CROSSING, tmp_path / "page", "--serve", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT) as process:
        try:
            address = process.stdout.readline().decode().strip()
            assert address.startswith(f"http://127.0.0.1:{port}")
            with urllib.request.urlopen(address, timeout=PATIENCE) as answer:
                assert b"<title>" in answer.read()
        finally:
            process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0


def test_a_table_is_imported(tmp_path):
    (tmp_path / "tracks.csv").write_text("t,id,east,y\n0,7,1,2\n1,7,2,2\n")
    done = run("import", tmp_path / "tracks.csv", tmp_path / "out.log", "--column", "x=east", "--hero", "7")
    assert (done.returncode, wrote(done.stderr)) == (0, [f"{tmp_path / 'out.log'}: 2 frames, 1 s"])


@pytest.mark.parametrize("date", ["2024-05-01T12:30:00Z", "2024-05-01T14:30+02:00", local_date(1_714_566_600)])
def test_an_import_has_a_date(tmp_path, date):
    (tmp_path / "tracks.csv").write_text("t,id,x,y\n0,7,1,2\n")
    assert run("import", tmp_path / "tracks.csv", tmp_path / "out.log", "--date", date).returncode == 0
    with open_recording(tmp_path / "out.log") as recording:
        assert recording.header.date == 1_714_566_600
