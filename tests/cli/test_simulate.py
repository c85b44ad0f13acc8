"""The command that makes recordings."""

from __future__ import annotations

import subprocess

import pytest

from carla_recap import open_recording
from tests.cli.command import COMMAND, ENVIRONMENT, TIMEOUT, error, on_terminal, run, the_line

pytest.importorskip("pymunk", reason="the extra `sim` is not installed")

FEW = ("--vehicles", "3", "--walkers", "2", "--duration", "2")


def test_record(tmp_path):
    path = tmp_path / "traffic.mcap"
    done = run("record", path, *FEW, "--hero", "--seed", "4", "--additional-data")
    assert (done.returncode, done.stdout) == (0, b"")
    assert done.stderr.decode() == f"{path}: 40 frames, 2 s\n"
    with open_recording(path) as recording:
        assert recording.info.map_name == "Brickfield"
        assert recording.info.additional_data
        kinds = [actor.kind for actor in recording.actors.values()]
        assert (kinds.count("vehicle"), kinds.count("walker")) == (3, 2)
        assert len(recording.heroes) == 1


@pytest.mark.parametrize("suffix", [".mcap", ".log"])
def test_the_same_seed_makes_the_same_bytes(tmp_path, suffix):
    environment = ENVIRONMENT | {"SOURCE_DATE_EPOCH": "1767261600"}
    paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for path in paths:
        subprocess.run([COMMAND, "record", path, *FEW], env=environment, timeout=TIMEOUT, check=True, capture_output=True)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_what_is_there_stays(tmp_path):
    (tmp_path / "mine.log").write_text("mine")
    assert "exists already" in error("record", tmp_path / "mine.log", *FEW)
    assert (tmp_path / "mine.log").read_text() == "mine"


def test_what_cannot_be_recorded(tmp_path):
    assert "town 'Atlantis': expected Brickfield" in error("record", tmp_path / "a.log", "--town", "Atlantis")
    assert "unknown format" in error("record", tmp_path / "a.txt", *FEW)
    assert "has room for" in error("record", tmp_path / "a.log", "--vehicles", "1000", "--walkers", "0")
    assert list(tmp_path.iterdir()) == []


def test_it_shows_how_far_it_is(tmp_path):
    code, shown, _ = on_terminal("record", tmp_path / "a.mcap", *FEW, stream="stderr")
    assert code == 0
    assert "simulating" in shown


def test_without_the_extra_there_is_one_line(tmp_path):
    (tmp_path / "pymunk.py").write_text("raise ImportError('no pymunk here')")
    command = [COMMAND, "record", tmp_path / "a.mcap", *FEW]
    environment = ENVIRONMENT | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=environment, capture_output=True, timeout=TIMEOUT, check=False)
    assert done.returncode == 2
    assert "pip install 'carla-recap[sim]'" in the_line(done.stderr)
