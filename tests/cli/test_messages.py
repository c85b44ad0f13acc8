"""What commands print beside answers: success lines, JSON of them, progress, the log, colours, errors; in this process."""

from __future__ import annotations

import io
import json
import logging
import os
import pty
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import click
import pytest

from carla_recap import cli, create_recording
from carla_recap.cli.output import log_to_stderr
from carla_recap.output.terminal import TableColumn, print_table
from tests.cli.command import CROSSING, ENVIRONMENT, run_here, written, wrote
from tests.waiting import PATIENCE

CRASH = CROSSING.with_name("crash.mcap")
WRITING = ("capture", "clip", "clips", "convert", "export", "import", "index", "record", "recover", "replay", "report")
WRITING += ("sense", "snapshot", "video")
ASKING = ("actors", "blocked", "campaign", "check", "collisions", "diff", "doctor", "incidents", "info", "measures", "score")
ASKING += ("sql", "summary")


class Done(NamedTuple):
    code: int
    out: str
    err: str


@pytest.fixture
def invoke(monkeypatch, tmp_path):
    """A function that runs a command with both streams on terminals, or in pipes, in an empty folder."""

    def run(*arguments, terminal=False):
        streams = pty.openpty if terminal else os.pipe
        with written(*streams()) as (out, printed), written(*streams()) as (err, said):
            code = run_here([str(argument) for argument in arguments], out, err)
            return Done(code, *(text().decode().replace("\r\n", "\n") for text in (printed, said)))

    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(ENVIRONMENT, "COLUMNS", "80")
    return run


# --- options of all commands -------------------------------------------------------------------------------


def test_every_command_has_the_options_of_all_commands():
    context = click.Context(cli.cli, **cli.cli.context_settings)
    for name in cli.cli.list_commands(context):
        command = cli.cli.get_command(context, name)
        options = [option for each in command.params for option in each.opts]
        assert [options.count(option) for option in ("-q", "--quiet", "-v", "--verbose")] == [1, 1, 1, 1], name
        assert ("--json" in options) == (name in WRITING + ASKING), name
        assert command.get_help(click.Context(command, context, name)).startswith(f"Usage: {name} "), name


@pytest.mark.parametrize("arguments", [("-q", "convert"), ("convert", "--quiet")], ids=" ".join)
def test_quiet_prints_nothing_before_and_after_the_command(invoke, arguments):
    assert invoke(*arguments, CROSSING, "out.mcap", terminal=True) == (0, "", "")


def test_quiet_prints_errors_and_warnings(invoke, tmp_path):
    done = invoke("-q", "convert", "missing.log", "out.mcap")
    assert done == (2, "", "carla-recap: missing.log: No such file or directory\n")
    (tmp_path / "cut.log").write_bytes(CROSSING.read_bytes()[:-10])
    done = invoke("-q", "convert", "cut.log", "out.mcap")
    assert done.code == 0
    assert done.err.startswith("carla-recap: warning: cut.log: ")


def test_verbose_logs_what_is_done(invoke):
    for arguments in (("-v", "convert"), ("convert", "-v")):
        done = invoke(*arguments, CROSSING, "out.mcap", "--force")
        assert f"carla-recap: info: opens {CROSSING} (CARLA's log)\n" in done.err
        assert "carla-recap: debug: " not in done.err
        assert wrote(done.err) == ["out.mcap: 531 frames, 53 s"]
    assert "carla-recap: debug: out.mcap is complete\n" in invoke("convert", "-vv", CROSSING, "out.mcap", "--force").err


def test_a_warning_is_printed_once_however_often_the_log_is_asked_for(capsys):
    for _ in range(2):
        log_to_stderr()
    logging.getLogger("carla_recap").warning("one of its kind")
    assert capsys.readouterr().err == "carla-recap: warning: one of its kind\n"


# --- success lines -----------------------------------------------------------------------------------------


def test_a_success_line_says_what_was_written(invoke):
    done = invoke("clip", CROSSING, "out.log", "--duration", "2")
    assert done.out == ""
    size = Path("out.log").stat().st_size
    assert done.err == f"wrote out.log: 21 frames, 2 s, {size / 1e3:.0f} kB\n"


def test_json_of_what_was_written(invoke):
    done = invoke("clip", CROSSING, "out.log", "--duration", "2", "--json", "-q")
    assert (done.code, done.err) == (0, "")
    size = Path("out.log").stat().st_size
    assert json.loads(done.out) == {"written": [{"path": "out.log", "frames": 21, "seconds": 2.0, "bytes": size}]}


def test_json_of_nothing_written_is_an_empty_list(invoke):
    done = invoke("clips", CROSSING, "clips", "--min-time", "1000", "--kinds", "blocked", "--json")
    assert (done.code, json.loads(done.out)) == (0, {"written": []})
    assert done.err == "clips: no incidents, no clips\n"


def test_no_json_is_printed_with_an_error(invoke):
    assert invoke("convert", "missing.log", "out.mcap", "--json").out == ""


# --- colours -----------------------------------------------------------------------------------------------


def test_json_of_clips(invoke):
    done = invoke("clips", CROSSING, "out", "--kinds", "collision", "--no-rrd", "--json")
    written = json.loads(done.out)["written"]
    assert [each["kind"] for each in written] == ["collision", "collision"]
    assert all(Path(each["path"]).is_file() for each in written)
    assert len(wrote(done.err)) == 2


def test_a_terminal_gets_colors(invoke, tmp_path):
    assert "\x1b[31m\x1b[1mcarla-recap:\x1b[0m missing.log: " in invoke("info", "missing.log", terminal=True).err
    (tmp_path / "cut.log").write_bytes(CROSSING.read_bytes()[:-10])
    done = invoke("convert", "cut.log", "out.mcap", terminal=True)
    assert "\x1b[33m\x1b[1mcarla-recap: warning:\x1b[0m cut.log: " in done.err
    assert "\x1b[32m\x1b[1mwrote\x1b[0m out.mcap: " in done.err


def test_kinds_in_tables_have_colors(invoke):
    assert re.search("\x1b\\[31mcollision", invoke("incidents", CRASH, terminal=True).out)


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_colors_are_switched_off(invoke, monkeypatch, name, value):
    monkeypatch.setitem(ENVIRONMENT, name, value)
    assert not re.search("\x1b\\[[0-9;]*3[0-9]m", invoke("incidents", CRASH, terminal=True).out)
    assert invoke("info", "missing.log", terminal=True).err == "carla-recap: missing.log: No such file or directory\n"


def test_a_pipe_gets_no_colors_unless_they_are_forced(invoke, monkeypatch):
    assert "\x1b" not in invoke("info", "missing.log").err
    monkeypatch.setitem(ENVIRONMENT, "FORCE_COLOR", "1")
    assert "\x1b[31m" in invoke("info", "missing.log").err
    monkeypatch.setitem(ENVIRONMENT, "NO_COLOR", "1")
    assert "\x1b" not in invoke("info", "missing.log").err


def test_a_dumb_terminal_gets_no_progress(invoke, monkeypatch):
    monkeypatch.setitem(ENVIRONMENT, "TERM", "dumb")
    done = invoke("convert", CROSSING, "out.mcap", terminal=True)
    assert wrote(done.err) == [done.err.removeprefix("wrote ").rpartition(", ")[0]]


# --- tables ------------------------------------------------------------------------------------------------


def lines_of(done: Done) -> list[str]:
    return re.sub(r"\x1b\[[0-9;]*m", "", done.out).splitlines()


def test_actors_that_move_come_first(invoke):
    kinds = [line.split()[1] for line in lines_of(invoke("actors", CRASH, terminal=True))[3:-1]]
    assert kinds[:2] == ["vehicle", "vehicle"]
    order = list(dict.fromkeys(kinds))
    assert order == ["vehicle", "walker", "traffic_light", "sensor", "traffic_sign", "other"]
    assert lines_of(invoke("actors", CROSSING, terminal=True))[3].split()[1:4] == ["vehicle", "tesla.model3", "hero"]


@pytest.mark.parametrize("command", ["actors", "blocked", "collisions", "incidents", "measures"])
def test_a_row_is_a_line_in_80_columns(invoke, command):
    rows = json.loads(invoke(command, CRASH, "--json").out)["rows"]
    lines = [line for line in lines_of(invoke(command, CRASH, terminal=True)) if line and not line.startswith("(")]
    assert max(map(len, lines)) <= 80
    assert len(rows) <= len(lines) - 4 <= len(rows) + 1  # the map, headings, a line, the rows, their number


def test_a_table_fits_in_any_terminal():
    from rich.console import Console

    recording, error = TableColumn("Recording", narrowed="middle"), TableColumn("Error", narrowed="words")
    columns = [recording, TableColumn("Id", is_number=True), error]
    for width in (1, 10, 40, 200):
        stream = io.StringIO()
        print_table(columns, [["runs/" + "a" * 90, "1", "it is " * 20]], Console(file=stream, width=width))
        assert max(map(len, stream.getvalue().splitlines())) <= width


# --- errors ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("other", "told"), [("Town5", "an unknown map: 'Town5'"), ("", "unknown maps: 'Town5', (no name)")])
def test_unknown_maps_of_many_recordings_are_one_warning(invoke, other, told):
    for path, name in (("a.mcap", "Town5"), ("b.mcap", other)):
        create_recording(path, map_name=name).close()
    done = invoke("incidents", "--kinds", "all", "a.mcap", "b.mcap")
    assert done.err.startswith(f"carla-recap: warning: 2 recordings are of {told}; ")
    assert done.err.count("\n") == 1
    assert "a.mcap: the map 'Town5' is unknown" in invoke("incidents", "--kinds", "all", "a.mcap").err


def test_ctrl_c_while_the_commands_are_imported_ends_the_process_without_a_traceback():
    code = """
import os, signal, sys

class Finder:
    def find_spec(self, name, *_):
        if name == "carla_recap.cli":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
from carla_recap.__main__ import main
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, b"")
