"""The commands that simulate: record and replay."""

from __future__ import annotations

import re
import shlex
import shutil
import signal
import subprocess

import pytest

from carla_recap import open_recording
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, error, run, the_line, wrote
from tests.samples import CRASH, names_in
from tests.waiting import PATIENCE, wait_until

pytest.importorskip("pymunk", reason="the extra `sim` is not installed")

FEW = ("--vehicles", "3", "--walkers", "2", "--duration", "2")


def test_record(tmp_path):
    path, undated = tmp_path / "traffic.mcap", {key: ENVIRONMENT[key] for key in ENVIRONMENT if key != "SOURCE_DATE_EPOCH"}
    done = run("record", path, *FEW, "--hero", "--seed", "4", "--additional-data", env=undated)
    assert (done.returncode, done.stdout) == (0, b"")
    assert wrote(done.stderr) == [f"{path}: 40 frames, 1.95 s"]
    with open_recording(path) as recording:
        assert (recording.info.map_name, recording.header.date) == ("Brickfield", 1_767_261_600)  # of a seed, on any day
        assert recording.info.additional_data
        kinds = [actor.kind for actor in recording.actors.values()]
        assert (kinds.count("vehicle"), kinds.count("walker")) == (3, 2)
        assert len(recording.heroes) == 1


@pytest.mark.parametrize("command", [("record",), ("replay", CROSSING)])
def test_missing_folders_are_made(tmp_path, command):
    path = tmp_path / "new" / "folder" / "a.log"
    assert run(*command, path, "--duration", "0.1").returncode == 0
    assert names_in(path.parent) == ["a.log"]


def test_a_missing_map_is_an_error_with_the_folders(tmp_path):
    missing = tmp_path / "no"
    done = run("record", tmp_path / "a.log", "--town", "Atlantis", env=ENVIRONMENT | {"CARLA_RECAP_MAPS": str(missing)})
    assert the_line(done.stderr).endswith(f"{missing}, which is missing")


def test_a_staged_scene_has_the_hero_of_the_scene_alone(tmp_path):
    assert run("record", tmp_path / "a.mcap", "--crash", "--hero", *FEW).returncode == 0
    with open_recording(tmp_path / "a.mcap") as recording:
        assert len(recording.heroes) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_completes_the_recording(tmp_path, number):
    path = tmp_path / "a.mcap"
    command = [COMMAND, "record", path, "--vehicles", "1", "--walkers", "0", "--duration", "inf"]
    with subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE) as process:
        wait_until(lambda: any(each.stat().st_size > 10_000 for each in tmp_path.iterdir()))
        process.send_signal(number)
        try:
            _, stderr = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode == 128 + number
    (line,) = wrote(stderr)
    assert re.fullmatch(rf"{re.escape(str(path))}: \d+ frames?, [\d.]+ s", line)
    with open_recording(path) as recording:
        assert recording.info.frames > 0


@pytest.mark.parametrize("suffix", [".mcap", ".log"])
def test_a_full_disk_ends_the_recording_and_keeps_it(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    record = shlex.join([str(COMMAND), "record", str(path), "--vehicles", "3", "--walkers", "0"])
    done = subprocess.run(
        ["bash", "-c", f"ulimit -f 100; {record}"], env=ENVIRONMENT, capture_output=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 2
    assert the_line(done.stderr).startswith("warning: the recording has ended: ")
    assert b"cannot be written: File too large; " in done.stderr
    (left,) = tmp_path.iterdir()
    assert left.stat().st_size <= 100 << 10
    if left != path:  # there was no room for its end
        assert f"{left}, for carla-recap recover" in done.stderr.decode()
        assert run("recover", left, path).returncode == 0
    with open_recording(path) as recording:
        assert 1 < recording.info.duration < 60


# --- replays -----------------------------------------------------------------------------------------------------------


def test_a_replay_is_recorded_with_what_the_autopilot_drives(tmp_path):
    done = run("replay", CRASH, tmp_path / "again.mcap", "--start", "10", "--duration", "1", "--then", "0.5")
    assert (done.returncode, done.stdout) == (0, b"")
    assert wrote(done.stderr) == [f"{tmp_path / 'again.mcap'}: 32 frames, 1.55 s, by autopilot from frame 22 on"]
    with open_recording(CRASH) as first, open_recording(tmp_path / "again.mcap") as second:
        before, after = first.trajectory("hero"), second.trajectory("hero")
    assert after.x[:21] == pytest.approx(before.x[before.time > 9.999][:21], abs=0.01)


def test_a_replay_in_a_given_town_without_the_hero(tmp_path):
    part = ("--duration", "1", "--then", "0", "--ignore-hero")
    done = run("replay", CROSSING, tmp_path / "a.mcap", "--town", "Brickfield", *part)
    assert done.returncode == 0
    first, second = done.stderr.decode().splitlines()
    assert first.endswith("crossing.log: is a recording of the map 'Crossing', and replayed in 'Brickfield'")
    assert "22 frames" in second
    with open_recording(tmp_path / "a.mcap") as recording:
        assert (recording.info.map_name, recording.heroes) == ("Brickfield", [])


def test_a_recording_is_not_replayed_onto_itself(tmp_path):
    crash = shutil.copy(CRASH, tmp_path / "crash.mcap")
    (tmp_path / "link.mcap").symlink_to(crash)
    before = crash.read_bytes()
    for source in (crash, crash.with_suffix("")):
        for destination in (crash, tmp_path / "link.mcap"):
            assert error("replay", source, destination, "--force") == f"{destination}: is the source itself"
    assert crash.read_bytes() == before
