"""The commands index and sql, as a shell and a terminal see them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.command import answer, error, on_terminal, run, wrote
from tests.samples import SAMPLES

pytest.importorskip("duckdb", reason="the extra `sql` is not installed")


@pytest.fixture(scope="module")
def index(tmp_path_factory):
    """An index of two samples."""
    folder = tmp_path_factory.mktemp("cli") / "index"
    done = run("index", SAMPLES / "crash.mcap", SAMPLES / "crossing.log", folder)
    assert done.returncode == 0
    return folder


def test_a_run_ends_with_one_line_and_the_next_reads_nothing(tmp_path):
    events = ", events alone (--measures adds near misses)"
    for counts, hint in (("1 read, 0 failed, 0 unchanged", events), ("0 read, 0 failed, 1 unchanged", "")):
        done = run("index", SAMPLES / "crossing.log", tmp_path / "index")
        assert (done.returncode, done.stdout) == (0, b"")
        assert wrote(done.stderr) == [f"{tmp_path}/index: 1 recording ({counts}){hint}"]
    done = run("index", "--prune", SAMPLES / "crash.mcap", tmp_path / "index")
    assert b"1 recording (1 read, 0 failed, 0 unchanged, 1 removed)" in done.stderr


def test_an_answer_without_near_misses_says_how_they_are_found(index):
    for query in (
        "select * from incidents where kind = 'near miss'",
        "select count(*) from incidents where kind = 'near miss'",
    ):
        done = run("sql", index, query)
        assert done.returncode == 0
        assert "2 recordings without near misses, measures" in done.stderr.decode()
    assert run("sql", index, "select kind from incidents").stderr == b""


def test_recordings_that_cannot_be_read_are_named_and_the_exit_code_is_2(tmp_path):
    (tmp_path / "empty.log").touch()
    shutil.copy(SAMPLES / "crossing.log", tmp_path)
    done = run("index", "--measures", tmp_path, tmp_path / "index")
    failure, summary, warning = done.stderr.decode().splitlines()
    assert done.returncode == 2
    assert failure.startswith(f"carla-recap: {tmp_path}/empty.log: is empty")
    assert wrote(summary) == [f"{tmp_path}/index: 2 recordings (1 read, 1 failed, 0 unchanged)"]
    assert warning.startswith("carla-recap: warning: unknown maps: 'Crossing'; ")
    again = run("index", tmp_path, tmp_path / "index")
    assert again.returncode == 0
    assert b"(0 read, 0 failed, 2 unchanged, 1 of them with an error)" in again.stderr


@pytest.mark.parametrize(
    ("form", "expected"),
    {
        "--csv": 'map,frames,actors,note\nBrickfield,1200,"[41, 44]","a ""b"""\n',
        "--json": '{"rows": [\n{"map": "Brickfield", "frames": 1200, "actors": [41, 44], "note": "a \\"b\\""}\n]}\n',
    }.items(),
)
def test_rows_as_text(index, form, expected):
    query = "select map, frames, i.actors, 'a \"b\"' as note from recordings join incidents i using (recording)"
    assert answer("sql", index, f"{query} where text like '%walker.pedestrian.0004 (44)'", form) == expected


def test_in_a_pipe_rows_are_csv_and_on_a_terminal_a_table(index):
    query = "select map, frames, duration from recordings order by map"
    assert answer("sql", index, query) == answer("sql", index, query, "--csv")
    code, shown, _ = on_terminal("sql", index, query)
    lines = [line.split() for line in shown.splitlines()]
    assert code == 0
    assert lines[2:] == [["Brickfield", "1200", "59.95"], ["Crossing", "531", "53"], ["2", "rows"]]


def test_wide_rows_are_lists_on_a_terminal(index):
    _, shown, _ = on_terminal("sql", index, "select * from recordings where map = 'Crossing'")
    assert "additional_data" in shown
    assert all(len(line) <= 120 for line in shown.splitlines())


def test_values_of_every_kind_are_printed(index):
    values = {
        "1.5::decimal(4, 2)": 1.5,
        "2.00::decimal(4, 2)": 2,
        "'nan'::double": None,
        "date '2026-01-02'": "2026-01-02",
        "timestamp '2026-01-02 03:04:05'": "2026-01-02 03:04:05",
        "timestamptz '2026-01-02 03:04:05+00'": "2026-01-02 03:04:05+00",
        "time '03:04:05'": "03:04:05",
        "'ab'::blob": "ab",
        "map {'a': 1}": {"a": 1},
        "map {}": {},
        "interval '2 days'": "2 days",
        "{'a': [1, null]}": {"a": [1, None]},
        "null": None,
        "date 'infinity'": "infinity",
        "true": True,
        "170141183460469231731687303715884105727": 170141183460469231731687303715884105727,
        "'é\n'": "é\n",
    }
    columns = ", ".join(f"{value} as c{number}" for number, value in enumerate(values))
    (row,) = json.loads(answer("sql", index, f"select {columns}", "--json"))["rows"]
    assert list(row.values()) == list(values.values())


def test_columns_of_one_name_are_numbered(index):
    assert answer("sql", index, "select 1 as a, 2 as a, 3 as a") == "a,a_1,a_2\n1,2,3\n"


def test_a_query_without_rows(index):
    assert answer("sql", index, "select map from recordings where false") == "map\n"
    assert json.loads(answer("sql", index, "select map from recordings where false", "--json")) == {"rows": []}
    assert on_terminal("sql", index, "select map from recordings where false")[1] == "0 rows\n"


def test_names_of_recordings_cannot_control_the_terminal(index):
    _, shown, _ = on_terminal("sql", index, "select chr(27) || '[2J' as a, chr(7) as b")
    assert "\x1b[2J" not in shown
    assert r"\x1b[2J" in shown


def test_a_query_is_read_from_stdin_if_it_is_utf_8(index):
    assert run("sql", index, "-", input=b"select 1 as n").stdout == b"n\n1\n"
    for query, text in (("-", b"select '\xff'"), (b"select '\xff'", b"")):
        assert "is not UTF-8" in error("sql", index, query, input=text)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (("sql", "INDEX", "-"), "stdin: a query of at most 1,048,576 bytes was expected"),
        (("collisions", "-"), "stdin: line 1: a path or a URL of at most 65,536 bytes was expected"),
    ],
)
def test_stdin_without_an_end_is_an_error(index, command, message):
    arguments = [index if argument == "INDEX" else argument for argument in command]
    with Path("/dev/zero").open("rb") as zeros:
        assert error(*arguments, stdin=zeros) == message
