"""The commands that query and convert, and the behaviour of all commands."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click import Context

from carla_recap import Attribute, Spawn, __version__, create_recording
from carla_recap.cli import cli
from carla_recap.formats.carla_log import LogReader
from carla_recap.output.text import text
from carla_recap.queries.blocked import blocked
from carla_recap.queries.collisions import collisions
from carla_recap.queries.info import info
from carla_recap.queries.recorded_actors import actors
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, answer, error, on_terminal, run, the_line
from tests.samples import names_in, reading, save
from tests.waiting import PATIENCE, time_limit

COMMANDS = cli.list_commands(Context(cli))
EVIL = "\x1b]0;evil\x07\x1b[31m\x9b2J"


@pytest.fixture(autouse=True)
def utc(monkeypatch):
    """Dates are printed in local time; here, as in the command."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "UTC")
        time.tzset()
        yield
    time.tzset()


@pytest.fixture
def evil(tmp_path) -> Path:
    """A recording with texts that would control a terminal."""
    path = tmp_path / "evil.mcap"
    with create_recording(path, map_name=EVIL, date=0) as recorder:
        one = Spawn(1, 1, 0, 0, 0, 0, 0, 0, 0, EVIL, [Attribute(3, "role_name", EVIL)])
        recorder.add_frame(0.0, spawned=[one], transforms={"id": [1]})
        recorder.add_frame(40.0, collisions=[(0, 1, 1, 0, 0)])
        recorder.add_frame(41.0)
    return path


def text_of(query: Callable[..., Any], path: Path, *arguments: Any, **options: Any) -> str:
    """Return the answer of the Python API as CARLA's text."""
    with reading(path) as reader:
        return "".join(text(query(reader, *arguments, **options)))


# --- answers in a pipe -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "query", "options"),
    [
        (["info"], info, {}),
        (["info", "--all", "--compat"], info, {"all": True, "compat": True}),
        (["collisions", "--types", "hv"], collisions, {"type1": "h", "type2": "v"}),
        (["blocked", "--min-time", "5", "--min-distance", "50"], blocked, {"min_time": 5.0, "min_distance": 50.0}),
        (["actors"], actors, {}),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_pipe_gets_text(arguments, query, options):
    command, *rest = arguments
    assert answer(command, CROSSING, *rest) == text_of(query, CROSSING, **options)


def test_a_time_of_0_is_accepted_and_with_compat_a_negative_one():
    assert answer("blocked", CROSSING, "--min-time", "0")
    rows = answer("blocked", CROSSING, "--compat", "--min-time", "-1").splitlines()
    assert len(rows) > len(answer("blocked", CROSSING, "--compat", "--min-time", "0.5").splitlines())


@pytest.mark.parametrize("command", [["info"], ["info", "--compat"], ["collisions"], ["blocked"], ["actors"]], ids=" ".join)
def test_text_cannot_control_a_terminal(evil, command):
    name, *rest = command
    code, shown, _ = on_terminal(name, evil, "--text", *rest)
    assert code == 0
    assert all(line.isprintable() for line in shown.split("\n"))
    assert "\\x1b]0;evil\\x07\\x1b[31m\\x9b2J" in shown
    assert EVIL in answer(name, evil, "--text", *rest)  # in a pipe the bytes are as they are


@pytest.mark.parametrize("command", ["info", "blocked"])
def test_json(command):
    document = json.loads(answer(command, CROSSING, "--json"))
    about = ["frames", "last_frame", "duration", *["sensors"] * (command == "info"), "warnings"]
    assert list(document) == ["version", "map", "date", "rows", *about]
    assert (document["map"], document["frames"], document["duration"]) == ("Crossing", 531, 53.0)
    assert document["rows"]


# --- on a terminal -----------------------------------------------------------------------------------------


def test_on_a_terminal_incidents_say_which_kinds_they_are():
    code, shown, errors = on_terminal("incidents", CROSSING)
    assert code == 0
    assert "hard braking" in shown
    assert errors.decode() == (
        "collisions, hard braking and long stops; --kinds all also finds near misses and broken rules\n"
    )
    assert on_terminal("incidents", CROSSING, "--kinds", "collision")[2] == b""


def test_a_contact_without_a_collision_record_is_said_where_there_are_no_incidents(tmp_path):
    path, two = tmp_path / "run.log", [Spawn(id, 1, type_id="vehicle.audi.tt") for id in (1, 2)]
    with create_recording(path, map_name="nowhere") as recorder:
        for number in range(40):  # the first drives at 10 m/s into the second, 20 m ahead
            poses = [(1, min(1000.0 + 50 * number, 2800.0), 0, 0, 0, 0, 0), (2, 3000, 0, 0, 0, 0, 0)]
            boxes = [(id, 0, 0, 0, 200, 100, 80) for id in (1, 2)]
            first = {"spawned": two, "bounding_boxes": boxes} if not number else {}
            recorder.add_frame(number / 20, transforms=poses, **first)
        recorder.add_frame(2.0, transforms=poses)
    done = run("incidents", path)
    assert (done.returncode, len(done.stdout.splitlines())) == (0, 8)
    assert the_line(done.stderr) == f"warning: {path}: 1 contact without a collision record, see --kinds near-miss"


@pytest.mark.parametrize("form", ["--text", "--json", "--compat"])
def test_options_choose_the_form_on_a_terminal(form):
    code, shown, errors = on_terminal("collisions", CROSSING, form)
    assert (code, errors) == (0, b"")
    if form == "--json":
        assert json.loads(shown)["rows"]
    else:
        assert shown == text_of(collisions, CROSSING, compat=form == "--compat")


def test_a_file_name_cannot_control_a_terminal(tmp_path):
    source, destination = tmp_path / f"[bold]{EVIL}.log", tmp_path / f"[bold]{EVIL}.mcap"
    source.symlink_to(CROSSING)
    code, shown, _ = on_terminal("convert", source, destination, stream="stderr")
    assert code == 0
    assert "31m" in shown
    assert not re.search("\x1b\\]|\x07|\x9b|\x1b\\[31m", shown)


# --- --max-rows --------------------------------------------------------------------------------------------


def test_max_rows():
    whole = text_of(collisions, CROSSING)
    assert answer("collisions", CROSSING, "--max-rows", 2) == whole
    done = run("collisions", CROSSING, "--max-rows", 1)
    assert (done.returncode, done.stdout.decode()) == (1, whole)
    assert the_line(done.stderr) == "2 rows, at most 1 were allowed"


# --- bad input ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [f"{EVIL}.log", "two\nlines.log", "\u202egol.log", "\udcff.log"])
def test_an_error_cannot_control_a_terminal(tmp_path, name):
    expected = "no recordings; a glob" if "[" in name else "No such file"
    assert expected in error("info", name, cwd=tmp_path)
    assert "unknown format" in error("convert", CROSSING, f"new.x{name.removesuffix('.log')}", cwd=tmp_path)


# --- stopped, or left alone --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def long_log(tmp_path_factory) -> Path:
    """A log whose conversion takes about a second."""
    data = CROSSING.read_bytes()
    reader = LogReader(CROSSING)
    begin = reader._start
    reader.close()
    return save(tmp_path_factory.mktemp("cli") / "long.log", data[:begin] + data[begin:] * 150)


@pytest.mark.parametrize(
    ("command", "number", "code"),
    [("convert", signal.SIGTERM, 143), ("recover", signal.SIGINT, 130)],
    ids=["convert", "recover"],
)
def test_a_conversion_that_is_stopped_leaves_nothing(tmp_path, long_log, command, number, code):
    there = save(tmp_path / "there.mcap", b"precious")
    arguments = [COMMAND, command, long_log, there, "--force"]
    with subprocess.Popen(arguments, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        with time_limit():
            while len(names_in(tmp_path)) < 2:  # until it writes, and not a moment longer
                assert process.poll() is None
        process.send_signal(number)
        output, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == code
    assert output == b""
    assert b"Traceback" not in errors
    assert errors.count(b"\n") <= 1
    assert names_in(tmp_path) == ["there.mcap"]
    assert there.read_bytes() == b"precious"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("arguments", [["info"], ["actors", "--json"]], ids=" ".join)
def test_a_full_disk_behind_stdout(arguments):
    environment = {name: value for name, value in ENVIRONMENT.items() if name != "PYTHONUNBUFFERED"}
    with Path("/dev/full").open("wb") as full:
        command = [COMMAND, arguments[0], CROSSING, *arguments[1:]]
        done = subprocess.run(command, env=environment, stdout=full, stderr=subprocess.PIPE, timeout=PATIENCE, check=False)
    assert done.returncode == 2
    assert the_line(done.stderr) == "output: No space left on device"


@pytest.mark.parametrize("sources", [[CROSSING], [CROSSING, CROSSING.with_name("crash.mcap"), "--jobs", "2"]], ids=len)
def test_the_reader_of_a_pipe_closes_it(sources):
    command = [COMMAND, "info", "--all", *sources]
    with subprocess.Popen(command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.read(100)
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(PATIENCE) in (0, -signal.SIGPIPE)  # 0: the pipe had room for all


@pytest.mark.parametrize("closed", [1, 2])
def test_an_answer_without_a_place_is_an_error(closed):
    command = ["sh", "-c", f'"$@" {closed}>&-', "sh", COMMAND, "info", CROSSING]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, check=False, timeout=PATIENCE)
    assert (done.returncode, done.stdout, done.stderr) == (2, b"", b"")


# --- help, version, start ----------------------------------------------------------------------------------


def test_help():
    for option in ("--help", "-h"):
        shown = answer(option)
        assert [name for name in COMMANDS if f"\n  {name} " in shown] == COMMANDS


def test_version():
    assert answer("--version") == f"carla-recap, version {__version__}\n"
    command = [sys.executable, "-m", "carla_recap", "--version"]
    assert subprocess.check_output(command, timeout=PATIENCE).decode() == answer("--version")


def imported(*arguments: object) -> set[str]:
    """Return the packages that a command imports."""
    command = [sys.executable, "-X", "importtime", COMMAND, *map(str, arguments)]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, timeout=PATIENCE, check=True)
    modules = re.findall(r"\| +([\w.]+)$", done.stderr.decode(), re.MULTILINE)
    assert "carla_recap.cli" in modules
    return {module.partition(".")[0] for module in modules}


def test_help_imports_nothing_heavy():
    heavy = {"google", "mcap", "numpy", "pandas", "pyarrow", "rich", "zstandard"}
    for arguments in (["--help"], ["info", "--help"], ["--version"]):
        assert not imported(*arguments) & heavy


@pytest.mark.parametrize("command", ["info", "incidents"])
def test_a_query_imports_only_what_it_uses(command):
    """A small recording is read in less time than some packages take to import."""
    unused = {"asyncio", "google", "json", "lz4", "pyarrow", "rich", "shutil", "ssl"}
    threads = {"concurrent", "logging"}  # for chunks that are read ahead
    assert not imported(command, CROSSING) & (unused | threads | {"mcap", "zstandard"})
    ahead = threads if command == "incidents" else set()
    assert not imported(command, CROSSING.with_name("crash.mcap")) & ((unused | threads) - ahead)
