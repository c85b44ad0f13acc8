"""An index that is interrupted at any moment, broken recordings, and folders with files of others."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import pytest

from benchmarks.campaign import BROKEN, make
from carla_recap import RecapError, open_index, write_index
from carla_recap.fleet.index.folder import IndexFolder
from carla_recap.fleet.index.reading import read_recording
from carla_recap.fleet.index.tables import TABLES
from tests.waiting import wait_until

pytest.importorskip("pyarrow", reason="the extra `arrow` is not installed")

SAMPLES = Path(__file__).parents[2] / "samples"
WRITE = """
import sys
from carla_recap.fleet.index import writing
writing._PAUSE = writing._SHARE = 0.0  # a commit for each recording
writing.MOST_PARTS = 5
writing.write_index([sys.argv[1]], sys.argv[2], jobs=int(sys.argv[3]))
"""


class Killed(BaseException):
    """The end of a process, as far as a test can simulate it in its own."""


@pytest.fixture
def runs(tmp_path):
    """A folder of eight recordings, one of which is broken."""
    make(tmp_path / "runs", 8, 1)
    return tmp_path / "runs"


@pytest.fixture
def often(monkeypatch):
    """Make a commit for each recording, merge after a few, and read each recording once in the whole test."""
    values = {"_PAUSE": 0.0, "_SHARE": 0.0, "MOST_PARTS": 2, "read_recording": cache(read_recording)}
    for name, value in values.items():
        monkeypatch.setattr(f"carla_recap.fleet.index.writing.{name}", value)
    monkeypatch.setattr("os.fsync", lambda _: None)


def contents(index):
    with open_index(index) as opened:
        return {name: sorted(repr(row) for row in opened.table(name).to_pylist()) for name in TABLES}


def write(runs, index):
    return write_index([runs], index, jobs=1)


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
    assert write(runs, tmp_path / "index").failed == 8
    errors = open_index(tmp_path / "index").table("recordings")["error"].to_pylist()
    assert sum("cannot be read: ZeroDivisionError: division by zero" in error for error in errors) == 7


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


@pytest.mark.usefixtures("often")
def test_after_an_end_at_any_change_of_a_file_the_next_run_makes_the_same_tables(tmp_path, monkeypatch):
    runs = tmp_path / "runs"
    make(runs, 3, 1)
    write(runs, tmp_path / "expected")
    expected = contents(tmp_path / "expected")
    replace, unlink = Path.replace, Path.unlink
    number = 0
    while True:
        index, left = tmp_path / f"index-{number}", number

        def ending(change):
            def changed(*arguments, **options):
                nonlocal left
                left -= 1
                if left < 0:
                    raise Killed
                return change(*arguments, **options)

            return changed

        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", ending(replace))
            patch.setattr(Path, "unlink", ending(unlink))
            try:
                write(runs, index)
                break
            except Killed:
                pass
        if (index / "index.json").exists():
            seen = contents(index)
            assert all(set(seen[name]) <= set(expected[name]) for name in TABLES)
        write(runs, index)
        assert contents(index) == expected
        shutil.rmtree(index)
        number += 1
    assert number > 20  # changes of files


def test_a_process_that_is_killed_again_and_again_makes_the_same_tables(tmp_path):
    make(tmp_path / "runs", 16, 2)
    index, rng = tmp_path / "index", random.Random(3)
    for _ in range(3):
        commits = _commits(index)
        process = subprocess.Popen([sys.executable, "-c", WRITE, tmp_path / "runs", index, "2"])
        wait_until(lambda process=process, commits=commits: process.poll() is not None or _commits(index) != commits)
        time.sleep(rng.uniform(0.0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.wait()
    write(tmp_path / "runs", index)
    write(tmp_path / "runs", tmp_path / "expected")
    assert contents(index) == contents(tmp_path / "expected")


def _commits(index):
    return sorted(item.name for item in (index / "recordings").glob("*.parquet"))


def test_what_a_killed_process_left_is_removed(runs, tmp_path):
    index = tmp_path / "index"
    write(runs, index)
    expected = contents(index)
    (index / "actors" / "part-00000002.parquet.partial").write_bytes(b"PAR1")
    shutil.copy(index / "actors" / "part-00000001.parquet", index / "actors" / "part-00000002.parquet")
    assert contents(index) == expected
    write(runs, index)
    assert [item.name for item in (index / "actors").iterdir()] == ["part-00000001.parquet"]


def test_recordings_that_were_read_before_an_interruption_are_kept(runs, tmp_path):
    def interrupted(outcomes, count):
        for number, outcome in enumerate(outcomes):
            if number == count // 2:
                raise KeyboardInterrupt
            yield outcome

    with pytest.raises(KeyboardInterrupt):
        write_index([runs], tmp_path / "index", jobs=1, progress=interrupted)
    assert write(runs, tmp_path / "index").unchanged == 4


# --- files of others ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [b"", b"no JSON", b"[]", b'{"recordings": {}}', b"[" * 100_000, b"\xff"])
def test_an_index_file_of_something_else_is_an_error(runs, tmp_path, content):
    (tmp_path / "index").mkdir()
    (tmp_path / "index" / "index.json").write_bytes(content)
    for use in (open_index, lambda index: write(runs, index)):
        with pytest.raises(RecapError, match="index") as caught:
            use(tmp_path / "index")
        assert "\n" not in str(caught.value)


def test_parts_that_are_not_those_of_an_index_are_errors_that_name_them(runs, tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    index = tmp_path / "index"
    write(runs, index)
    part = index / "actors" / "part-00000001.parquet"
    good = part.read_bytes()
    parquet.write_table(pa.table({"a": [1]}), part)
    foreign = part.read_bytes()
    for content in (foreign, good[: len(good) // 2], b""):
        part.write_bytes(content)
        with pytest.raises(RecapError, match=r"part-00000001\.parquet: ") as caught:
            open_index(index).table("actors")
        assert "\n" not in str(caught.value)


def test_files_with_other_names_are_left_alone(runs, tmp_path):
    write(runs, tmp_path / "index")
    expected = contents(tmp_path / "index")
    for name in ("notes.txt", "recordings/notes.txt", "actors/part-x.parquet"):
        (tmp_path / "index" / name).write_text("mine")
    write(runs, tmp_path / "index")
    assert contents(tmp_path / "index") == expected
    assert (tmp_path / "index" / "actors" / "part-x.parquet").read_text() == "mine"


def test_a_lock_of_a_killed_process_does_not_block_the_next(tmp_path):
    hold = "import sys, time; from carla_recap.fleet.index.folder import IndexFolder\n"
    hold += "with IndexFolder(sys.argv[1]).locked(): print('locked', flush=True); time.sleep(1000)"
    with subprocess.Popen([sys.executable, "-c", hold, tmp_path / "index"], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"locked\n"
        with pytest.raises(RecapError, match="another process"), IndexFolder(tmp_path / "index").locked():
            pass
        process.kill()
    with IndexFolder(tmp_path / "index").locked():
        pass


@pytest.mark.parametrize("index", ["file", "file/index", "\0"])
def test_a_destination_that_cannot_be_a_folder_is_an_error(runs, tmp_path, index):
    (tmp_path / "file").touch()
    with pytest.raises(RecapError) as caught:
        write(runs, f"{tmp_path}/{index}")
    assert "\n" not in str(caught.value)
