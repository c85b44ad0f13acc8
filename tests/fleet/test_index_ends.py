"""An index that is interrupted at any moment, damaged, or of something else, and broken recordings."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.campaign import BROKEN, make
from carla_recap import RecapError, open_index, write_index
from carla_recap.fleet.index.tables import TABLES
from tests.fleet.indexes import contents
from tests.samples import SAMPLES
from tests.waiting import wait_until

duckdb = pytest.importorskip("duckdb", reason="the extra `sql` is not installed")

WRITE = """
import sys
from carla_recap.fleet.index import writing
writing._PAUSE = writing._SHARE = 0.0  # a transaction for each recording
writing.write_index([sys.argv[1]], sys.argv[2], jobs=1)
"""


@pytest.fixture
def runs(tmp_path):
    """A folder of four recordings, one of which is broken."""
    make(tmp_path / "runs", 4, 1)
    return tmp_path / "runs"


def write(runs, index):
    return write_index([runs], index, jobs=1)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Recordings, their index and what it contains."""
    folder = tmp_path_factory.mktemp("written")
    make(folder / "runs", 4, 1)
    write(folder / "runs", folder / "index")
    return folder / "runs", folder / "index", contents(folder / "index")


def contents_or_error(index):
    """Return the tables, or the error if they cannot be read."""
    try:
        return contents(index)
    except RecapError as error:
        return str(error)


# --- broken recordings ----------------------------------------------------------------------------------------------------


def test_every_kind_of_broken_recording_is_a_row_with_its_error(tmp_path):
    make(tmp_path / "runs", 2 * len(BROKEN), len(BROKEN))
    summary = write(tmp_path / "runs", tmp_path / "index")
    assert (summary.read, summary.failed) == (len(BROKEN), len(BROKEN))
    rows = open_index(tmp_path / "index").table("recordings").to_pylist()
    failed = {Path(row["recording"]).name.split("-", 2)[2]: row["error"] for row in rows if row["error"]}
    assert set(failed) == set(BROKEN)
    assert all("\n" not in error for error in failed.values())


def test_an_error_that_no_check_has_foreseen_is_a_row(runs, tmp_path, monkeypatch):
    def fail(_):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr("carla_recap.fleet.index.reading.actors", fail)
    assert write(runs, tmp_path / "index").failed == 4
    errors = open_index(tmp_path / "index").table("recordings")["error"].to_pylist()
    assert sum("cannot be read: ZeroDivisionError: division by zero" in error for error in errors) == 3


def test_a_recording_that_was_cut_short_has_a_warning(tmp_path):
    (tmp_path / "cut.log").write_bytes((SAMPLES / "crossing.log").read_bytes()[:200_000])
    write(tmp_path / "cut.log", tmp_path / "index")
    (row,) = open_index(tmp_path / "index").table("recordings").to_pylist()
    assert row["error"] is None
    assert "the recording was cut short" in row["warning"]


def test_names_that_are_not_unicode_are_shown_with_escapes(tmp_path):
    name = b"caf\xe9.log"
    try:
        shutil.copy(SAMPLES / "crossing.log", os.fsencode(tmp_path) + b"/" + name)
    except OSError:
        pytest.skip("this file system has names in Unicode alone")
    assert write(tmp_path, tmp_path / "index").read == 1
    assert write(tmp_path / "*.log", tmp_path / "index").unchanged == 1
    (recording,) = open_index(tmp_path / "index").table("recordings")["recording"].to_pylist()
    assert recording.endswith("caf\\udce9.log")


# --- interruptions --------------------------------------------------------------------------------------------------------


def test_a_process_that_is_killed_again_and_again_makes_the_same_tables(tmp_path):
    make(tmp_path / "runs", 16, 2)
    write(tmp_path / "runs", tmp_path / "expected")
    expected = contents(tmp_path / "expected")
    index, rng, known = tmp_path / "index", random.Random(3), 0
    for _ in range(3):
        state = _state(index)
        process = subprocess.Popen([sys.executable, "-c", WRITE, tmp_path / "runs", index])
        wait_until(lambda process=process, state=state: process.poll() is not None or _state(index) != state)
        time.sleep(rng.uniform(0.0, 0.1))
        process.kill()
        process.wait()
        seen = contents(index)
        assert all(set(seen[name]) <= set(expected[name]) for name in TABLES)
        assert len(seen["recordings"]) >= known
        known = len(seen["recordings"])
        index.with_name("index.wal").unlink(missing_ok=True)  # which contains nothing that is needed
        assert contents(index) == seen
    write(tmp_path / "runs", index)
    assert contents(index) == expected


def _state(index):
    return index.stat().st_mtime_ns if index.exists() else None


@pytest.mark.parametrize(
    ("rows", "pause", "share", "seen"),
    [
        (1, 1000.0, 0.0, [*range(8)]),
        (10**6, 0.0, 0.0, [*range(8)]),
        (10**6, 1000.0, 0.0, [0] * 8),
        (10**6, 1.0, 0.5, [0, 1, 2, 2, 4, 4, 4, 4]),  # written after 10, 20, 40 and 80 s
    ],
)
def test_rows_are_written_when_they_are_many_or_have_waited(tmp_path, monkeypatch, rows, pause, share, seen):
    make(tmp_path / "runs", 8, 1)
    now, found = 0.0, []

    def watched(outcomes, count):
        nonlocal now
        for outcome in outcomes:
            now += 10.0
            found.append(open_index(tmp_path / "index").table("recordings").num_rows)
            yield outcome

    monkeypatch.setattr("carla_recap.fleet.index.writing.monotonic", lambda: now)
    for name, value in (("_ROWS", rows), ("_PAUSE", pause), ("_SHARE", share)):
        monkeypatch.setattr(f"carla_recap.fleet.index.writing.{name}", value)
    write_index([tmp_path / "runs"], tmp_path / "index", jobs=1, progress=watched)
    assert found == seen
    assert open_index(tmp_path / "index").table("recordings").num_rows == 8


def test_recordings_that_were_read_before_an_interruption_are_kept(runs, tmp_path):
    def interrupted(outcomes, count):
        for number, outcome in enumerate(outcomes):
            if number == count // 2:
                raise KeyboardInterrupt
            yield outcome

    with pytest.raises(KeyboardInterrupt):
        write_index([runs], tmp_path / "index", jobs=1, progress=interrupted)
    assert write(runs, tmp_path / "index").unchanged == 2


# --- damage ---------------------------------------------------------------------------------------------------------------


def test_an_index_that_is_cut_is_an_error_until_it_is_removed(written, tmp_path):
    runs, index, expected = written
    content = index.read_bytes()
    cut = tmp_path / "index"
    for share in (0.0, 0.001, 0.3, 0.6, 0.9, 0.9999):
        cut.write_bytes(content[: int(share * len(content))])
        for use in (contents, lambda path: write(runs, path)):
            with pytest.raises(RecapError, match=r"remove it, and 'carla-recap index SOURCE|is no index") as caught:
                use(cut)
            assert "\n" not in str(caught.value), share
    cut.unlink()
    write(runs, cut)
    assert contents(cut) == expected


def test_a_changed_bit_is_an_error_or_changes_nothing(written, tmp_path):
    runs, index, expected = written
    content, rng, errors = index.read_bytes(), random.Random(7), 0
    changed = tmp_path / "index"
    for number in range(12):
        places = len(content) if number % 2 else 12288  # the latter are the headers
        damaged = bytearray(content)
        damaged[rng.randrange(places)] ^= 1 << rng.randrange(8)
        changed.write_bytes(damaged)
        seen = contents_or_error(changed)
        if isinstance(seen, str):
            errors += 1
            assert str(changed) in seen
            assert "\n" not in seen
            with pytest.raises(RecapError, match="index"):
                write(runs, changed)
        else:
            assert seen == expected
            assert write(runs, changed).unchanged == 4
    assert errors > 5


def database(*statements):
    """Return a function that makes or changes a database."""

    def change(path):
        with duckdb.connect(path) as opened:
            for statement in statements:
                opened.execute(statement)

    return change


def index_and(statement):
    """Return a function that makes an index and changes it."""

    def make(path):
        write_index([SAMPLES / "crash.mcap"], path, jobs=1)
        database(statement)(path)

    return make


def earlier_index(path):
    path.mkdir()
    (path / "index.json").write_text("{}")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (Path.touch, "is empty; remove it"),
        (Path.mkdir, "is a folder"),
        (os.mkfifo, "no regular file"),
        (lambda path: path.write_bytes(b"no database"), "is no index of recordings"),
        (lambda path: path.write_bytes(bytes(20000)), "is no index of recordings|if the index is damaged"),
        (database("create table mine as select 1 as a"), "is no index of recordings"),
        (earlier_index, r"an earlier version .* 'carla-recap index SOURCE\.\.\. .*index\.duckdb' makes"),
        (index_and("alter table incidents drop column text"), "another version of carla-recap; remove it, and 'carla-recap"),
        (index_and("drop table sensors"), "another version of carla-recap; remove it"),
    ],
)
def test_what_is_no_index_is_an_error_and_stays(tmp_path, make, message):
    index = tmp_path / "index"
    make(index)
    before = index.read_bytes() if index.is_file() else None
    for use in (open_index, lambda path: write(SAMPLES / "crash.mcap", path)):
        with pytest.raises(RecapError, match=message) as caught:
            use(index)
        assert "\n" not in str(caught.value)
    assert (index.read_bytes() if index.is_file() else None) == before


@pytest.mark.parametrize("index", ["{}/file/index", "{}/\0", "{}/\udcff", "{}/" + "x" * 5000, "s3://bucket/index"])
def test_a_destination_that_cannot_be_a_file_is_an_error(tmp_path, index):
    (tmp_path / "file").touch()
    with pytest.raises(RecapError) as caught:
        write(SAMPLES / "crash.mcap", index.format(tmp_path))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
