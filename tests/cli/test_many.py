"""Queries of many recordings."""

from __future__ import annotations

import json
import os
import pty
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

from carla_recap import create_recording, open_recording
from carla_recap.output.table import cells
from carla_recap.queries.summary import summary
from carla_recap.roads import find_map
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, answer, on_terminal, run, run_here, the_line, written
from tests.samples import warnings_ignored
from tests.waiting import is_running, time_limit, wait_until

CRASH = CROSSING.with_name("crash.mcap")
MAP = {"measures": ("--map", find_map("Brickfield"))}  # else a warning says that the map is unknown


@pytest.fixture
def runs(tmp_path, monkeypatch) -> Path:
    """Three recordings and a broken one, in the working directory as `runs`."""
    folder = tmp_path / "runs"
    folder.mkdir()
    shutil.copy(CROSSING, folder / "a.log")
    shutil.copy(CRASH, folder / "b.mcap")
    (folder / "c.log").write_bytes(b"junk")
    shutil.copy(CROSSING, folder / "d.log")
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.fixture
def whole(runs) -> Path:
    (runs / "c.log").unlink()
    return runs


def lines(*arguments: object) -> list[str]:
    return answer(*arguments).splitlines()


# --- text --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["collisions", "measures"])
def test_rows_have_the_name_of_their_recording_in_front(whole, command):
    options = MAP.get(command, ())
    expected = [f"Recording\t{lines(command, CROSSING, *options)[4]}"]
    for name in ("a.log", "b.mcap", "d.log"):
        expected += [f"runs/{name}\t{row}" for row in lines(command, whole / name, *options)[5:-3]]
    assert lines(command, "runs", *options) == expected


def test_info_has_all_lines_of_each_recording(whole):
    text = [line for line in lines("info", CROSSING) if line]
    assert lines("info", "runs/a.log", "runs/d.log") == [
        f"runs/{name}\t{line}" for name in ("a.log", "d.log") for line in text
    ]


def test_csv_without_rows_has_its_heading(tmp_path):
    for name in ("a.mcap", "b.mcap"):
        create_recording(tmp_path / name, map_name="Brickfield").close()
    (heading,) = lines("measures", tmp_path / "a.mcap", "--csv", *MAP["measures"])
    assert lines("measures", tmp_path, "--csv", *MAP["measures"]) == [f"recording,{heading}"]


def test_a_list_of_recordings_is_read_from_stdin(whole):
    done = run("collisions", "-", input=b"runs/d.log\n\nruns/*.mcap\r\n")
    assert done.stdout.decode().splitlines() == lines("collisions", "runs/d.log", "runs/b.mcap")


# --- errors ------------------------------------------------------------------------------------------------


def test_a_broken_recording_is_a_line_on_stderr_and_not_the_end(runs):
    done = run("collisions", "runs", "--jobs", 1)
    assert done.returncode == 2
    assert the_line(done.stderr) == "runs/c.log: is not a recording (neither CARLA's log nor MCAP)"
    assert b"runs/d.log\t" in done.stdout


def test_a_recording_that_breaks_later_has_its_rows_until_then(runs):
    data = CRASH.read_bytes()
    (runs / "c.mcap").write_bytes(data[:-300])
    done = run("info", "runs/c.mcap", "runs/b.mcap")
    assert done.returncode == 2
    assert the_line(done.stderr).startswith("runs/c.mcap: ")


def test_a_source_that_means_nothing_is_reported(whole):
    done = run("collisions", "runs/*.json", "runs/a.log")
    assert done.returncode == 2
    assert the_line(done.stderr).startswith("runs/*.json: no recordings")
    assert b"runs/a.log\t" in done.stdout


def test_a_cut_recording_is_a_warning(whole):
    (whole / "a.log").write_bytes(CROSSING.read_bytes()[:-100])
    done = run("collisions", "runs")
    assert done.returncode == 0
    assert the_line(done.stderr).startswith("warning: runs/a.log: ")


@pytest.mark.parametrize(("allowed", "code"), [(6, 0), (5, 1)])
def test_max_rows_counts_the_rows_of_all(whole, allowed, code):
    done = run("collisions", "runs", "--max-rows", allowed)
    assert done.returncode == code
    assert done.stderr.decode() == (f"carla-recap: 6 rows, at most {allowed} were allowed\n" if code else "")


def test_an_unreadable_recording_matters_more_than_rows(runs):
    assert run("collisions", "runs", "--max-rows", "0").returncode == 2


# --- JSON --------------------------------------------------------------------------------------------------


def test_json_has_rows_and_recordings(runs):
    done = run("collisions", "runs", "--json")
    document = json.loads(done.stdout)
    assert done.returncode == 2
    assert list(document) == ["rows", "recordings"]
    for name in ("a.log", "b.mcap", "d.log"):
        alone = json.loads(answer("collisions", runs / name, "--json"))
        rows = [row for row in document["rows"] if row["recording"] == f"runs/{name}"]
        assert [dict(list(row.items())[1:]) for row in rows] == alone["rows"]
        (about,) = [each for each in document["recordings"] if each["recording"] == f"runs/{name}"]
        facts = {key: value for key, value in alone.items() if key != "rows"}
        assert about == {"recording": f"runs/{name}", "error": None, "rows": len(rows), "warnings": [], **facts}
    (broken,) = [each for each in document["recordings"] if each["error"]]
    assert broken["recording"] == "runs/c.log"
    assert (broken["rows"], broken["map"]) == (0, None)


def test_json_without_any_answer_is_valid(runs):
    done = run("blocked", "runs/c.log", "runs/missing.log", "--json")
    assert [each["rows"] for each in json.loads(done.stdout)["recordings"]] == [0, 0]


# --- terminals ---------------------------------------------------------------------------------------------


def test_a_terminal_gets_a_table_with_errors(runs):
    code, shown, _ = on_terminal("collisions", "runs")
    assert code == 2
    plain = re.sub(r"\x1b\[[0-9;]*m", "", shown)
    headings = [line.split() for line in plain.splitlines() if "Recording" in line]
    assert ["Recording", "Error"] in headings
    assert any("Frame" in heading for heading in headings)
    assert "runs/c.log is not a recording (neither CARLA's log nor MCAP)" in " ".join(plain.split())
    assert shown.splitlines()[-1] == "6 rows; 4 recordings, 1 failed"
    assert on_terminal("summary", "runs")[1].splitlines()[-1] == "3 rows; 4 recordings, 1 failed"


def test_text_on_a_terminal_has_spaces_for_tabs(whole):
    code, shown, _ = on_terminal("info", "runs", "--text")
    assert code == 0
    assert shown == answer("info", "runs").replace("\t", "  ")


def test_a_terminal_has_a_progress_bar_and_a_pipe_has_none(whole, tmp_path):
    with (tmp_path / "out").open("wb") as file, written(*pty.openpty()) as (terminal, shown):
        run_here(["incidents", "runs"], os.dup(file.fileno()), terminal)
        assert b"3/3" in shown()
    assert (tmp_path / "out").read_text() == answer("incidents", "runs")
    code, shown, _ = on_terminal("incidents", "runs", stream="stderr")
    assert (code, shown) == (0, "")


def test_names_cannot_control_a_terminal_or_break_a_line(whole):
    (whole / "a.log").rename(whole / "a\x1b[31m\n.log")
    _, shown, _ = on_terminal("collisions", "runs")
    assert "\x1b[31m" not in shown
    assert sum(line.count("\t") for line in lines("collisions", "runs")) == 7


# --- how it ends -------------------------------------------------------------------------------------------


def children(process: int) -> list[int]:
    return [int(pid) for pid in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def test_ctrl_c_ends_all_processes_at_once(tmp_path):
    folder = tmp_path / "slow"
    folder.mkdir()
    shutil.copy(CROSSING, folder / "0000.log")
    for index in range(1, 3000):
        os.link(folder / "0000.log", folder / f"{index:04}.log")
    command = [COMMAND, "info", "--all", folder, "--jobs", "2"]
    with subprocess.Popen(
        command, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        with time_limit():
            while len(workers := children(process.pid)) < 3:  # and one that tracks resources
                time.sleep(0.01)
            os.killpg(process.pid, signal.SIGINT)
            _, messages = process.communicate()
        assert process.returncode == 130
        assert messages.strip() == b""
        wait_until(lambda: not any(map(is_running, workers)))


def test_json_of_one_recording_has_its_warnings():
    done = run("summary", CROSSING, "--json")
    document, message = json.loads(done.stdout), the_line(done.stderr)
    assert [f"warning: {text}" for text in document["warnings"]] == [message]
    assert "'Crossing' is unknown" in message
    assert json.loads(run("actors", CROSSING, "--json").stdout)["warnings"] == []


def test_speeds_of_summaries_are_in_kilometres_per_hour():
    with open_recording(CROSSING) as recording, warnings_ignored():
        ((speed, counts),) = [row[-2:] for row in cells(summary(recording.reader))]
        assert speed == f"{recording.summary.hero.top_speed * 3.6:.0f}"
    assert counts.startswith("2 collisions")


def test_limits_of_near_misses_are_options():
    for name, option, value in (
        ("avoided.mcap", "--time-to-collision", 1.2),
        ("blocked.mcap", "--post-encroachment-time", 5),
    ):
        words = ("--kinds", "near-miss", "--json", option, value)
        near = json.loads(answer("incidents", CROSSING.with_name(name), *words))
        assert value in {row["threshold"] for row in near["rows"]}
