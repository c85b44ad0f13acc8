"""Commands that write a file for each of many recordings."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from carla_recap import open_recording
from carla_recap.editing.convert import convert
from tests.cli.command import COMMAND, CROSSING, ENVIRONMENT, error, on_terminal, run, wrote
from tests.waiting import PATIENCE, wait_until

CRASH = CROSSING.with_name("crash.mcap")


@pytest.fixture
def runs(tmp_path, monkeypatch) -> Path:
    """Two recordings, one of them in a folder below, and a broken one, in the working directory as `runs`."""
    folder = tmp_path / "runs"
    (folder / "deep").mkdir(parents=True)
    shutil.copy(CROSSING, folder / "a.log")
    shutil.copy(CRASH, folder / "deep" / "b.mcap")
    (folder / "c.log").write_bytes(b"junk")
    monkeypatch.chdir(tmp_path)
    return folder


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def messages(done: subprocess.CompletedProcess[bytes]) -> list[str]:
    return done.stderr.decode().splitlines()


def test_names_and_folders_are_kept_and_a_failure_is_a_line(runs):
    done = run("convert", "runs", "out")
    assert done.returncode == 2
    assert files(Path("out")) == {"a.mcap", "deep/b.mcap"}
    convert(CROSSING, "one.mcap")
    assert Path("out/a.mcap").read_bytes() == Path("one.mcap").read_bytes()
    junk = "carla-recap: runs/c.log: is not a recording (neither CARLA's log nor MCAP)"
    assert messages(done)[1:] == [
        junk,
        "wrote out/deep/b.mcap: 1200 frames, 59.95 s, 427 kB",
        "recordings: 2 done, 0 skipped, 1 failed",
    ]


def test_json_has_what_was_written_and_what_failed(runs):
    done = run("convert", "runs/*.log", "out/", "--format", "log", "--json", "-q")
    document = json.loads(done.stdout)
    assert [(each["path"], each["frames"]) for each in document["written"]] == [("out/a.log", 531)]
    assert [each["source"] for each in document["failed"]] == ["runs/c.log"]
    assert "is not a recording" in document["failed"][0]["error"]
    assert document["skipped"] == []
    assert Path("out/a.log").read_bytes() == CROSSING.read_bytes()


def test_what_is_there_is_not_replaced_unless_asked(runs):
    assert run("convert", runs / "a.log", "out/").returncode == 0
    before = Path("out/a.mcap").stat().st_mtime_ns
    done = run("convert", runs / "a.log", runs / "deep", "out/")
    assert done.returncode == 2
    assert messages(done)[0] == f"carla-recap: {runs}/a.log: out/a.mcap: exists already; --force replaces it"
    assert Path("out/a.mcap").stat().st_mtime_ns == before
    assert run("convert", runs / "a.log", "out/", "--force").returncode == 0
    assert Path("out/a.mcap").stat().st_mtime_ns > before


def test_newer_resumes(runs):
    (runs / "c.log").unlink()
    assert run("convert", "runs", "out").returncode == 0
    (Path("out") / "deep" / "b.mcap").unlink()
    done = run("convert", "runs", "out", "--newer", "--json")
    document = json.loads(done.stdout)
    assert [each["path"] for each in document["written"]] == ["out/deep/b.mcap"]
    assert document["skipped"] == ["out/a.mcap"]
    later = Path("out/a.mcap").stat().st_mtime + 10
    os.utime(runs / "a.log", (later, later))
    done = run("convert", "runs", "out", "--newer")
    assert wrote(done.stderr) == ["out/a.mcap: 531 frames, 53 s"]
    assert messages(done)[-1] == "recordings: 1 done, 1 skipped, 0 failed"


def test_newer_goes_with_a_single_file(runs):
    assert run("convert", "runs/a.log", "a.mcap", "--newer").returncode == 0
    assert messages(run("convert", "runs/a.log", "a.mcap", "--newer")) == ["a.mcap: is newer than its recording"]


def test_files_of_an_earlier_run_below_the_sources_are_skipped(runs):
    (runs / "c.log").unlink()
    for _ in range(2):
        done = run("convert", "runs", "runs/mcap", "--newer")
        assert done.returncode == 0
        assert files(runs) == {"a.log", "deep/b.mcap", "mcap/a.mcap", "mcap/deep/b.mcap"}
    assert messages(done) == ["recordings: 0 done, 2 skipped, 0 failed"]


def test_of_two_recordings_of_one_name_the_one_is_written_that_can_be(runs):
    shutil.copy(CRASH, runs / "c.mcap")
    shutil.copy(CRASH, runs / "deep" / "c.mcap")
    done = run("convert", "runs/c.log", "runs/a.log", "runs/c.mcap", "runs/deep/c.mcap", "out")
    assert done.returncode == 2
    assert files(Path("out")) == {"a.mcap", "c.mcap"}
    assert messages(done)[0] == "carla-recap: runs/c.log: is not a recording (neither CARLA's log nor MCAP)"
    assert messages(done)[-2:] == [
        "carla-recap: runs/deep/c.mcap: has the same name as runs/c.mcap; both would be written to out/c.mcap",
        "recordings: 2 done, 0 skipped, 2 failed",
    ]


def test_folders_that_stay_empty_are_removed(runs):
    (runs / "worse" / "still").mkdir(parents=True)
    shutil.copy(runs / "c.log", runs / "worse" / "still" / "d.log")
    assert run("convert", "runs/c.log", "new/out/").returncode == 2
    assert not Path("new").exists()
    assert run("convert", "runs", "new/out").returncode == 2
    assert sorted(path.name for path in Path("new/out").iterdir()) == ["a.mcap", "deep"]
    Path("kept").mkdir()
    assert run("convert", "runs/c.log", "kept/").returncode == 2
    assert Path("kept").is_dir()


def test_many_are_recovered(runs):
    (runs / "c.log").write_bytes(CROSSING.read_bytes()[:-3000])
    done = run("recover", "runs", "out", "--json")
    assert done.returncode == 0
    written = json.loads(done.stdout)["written"]
    assert [each["finished"] for each in written] == [True, False, True]
    assert [(each["headless"], each["without_events"]) for each in written] == [(False, False)] * 3


def test_many_are_exported(runs):
    done = run("export", "runs", "out", "--to", "csv", "--duration", 2)
    assert done.returncode == 2
    assert wrote(done.stderr) == ["out/a.csv: 21 frames, 2 s", "out/deep/b.csv: 41 frames, 2 s"]


def test_folders_of_many(runs):
    pytest.importorskip("pyarrow", reason="the extra `arrow` is not installed")
    done = run("export", "runs", "out", "--to", "parquet", "--jobs", 2)
    assert done.returncode == 2
    assert {"a/actors.parquet", "deep/b/transforms.parquet"} <= files(Path("out"))
    done = run("export", "runs", "out", "--to", "parquet", "--newer")
    assert messages(done)[-1] == "recordings: 0 done, 2 skipped, 1 failed"


def test_moments_of_many(runs):
    assert run("clip", "runs/a.log#t=20,21", "runs/deep/b.mcap#t=3,7", "out").returncode == 0
    for name, seconds in (("a", 1), ("b", 4)):
        with open_recording(f"out/{name}.mcap") as clip:
            assert clip.info.duration == pytest.approx(seconds, abs=0.2)


def test_a_page_of_each(runs):
    done = run("report", "runs", "out", "--pictures", "none", "--jobs", 2)
    assert done.returncode == 2
    assert files(Path("out")) == {"a.html", "deep/b.html"}
    warned = [line for line in messages(done) if "warning" in line]
    assert len(warned) == 1


@pytest.mark.parametrize(
    ("command", "word"),
    [
        (("convert", CROSSING, "out.mcap"), "converting"),
        (("record", "out.mcap", "--vehicles", 0, "--walkers", 0, "--duration", 1), "simulating"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_a_terminal_has_a_progress_bar(runs, command, word):
    code, shown, _ = on_terminal(*command, stream="stderr")
    assert (code, word in shown) == (0, True)
    assert shown.count("\x1b[?25l") == shown.count("\x1b[?25h") > 0  # the cursor is back


def test_ctrl_c_leaves_nothing_half_written(runs):
    for index in range(300):
        shutil.copy(CRASH, runs / f"{index}.mcap")
    command = [COMMAND, "convert", "runs", "out", "--jobs", "2", "--format", "log"]
    with subprocess.Popen(
        command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    ) as process:
        wait_until(lambda: len(files(Path("out"))) > 3 or process.poll() is not None)
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    found = files(Path("out"))
    assert 0 < len(found) < 300
    for name in found:
        assert name.endswith(".log")
        with open_recording(f"out/{name}") as recording:
            assert recording.info.frames in (531, 1200)


# --- object stores -----------------------------------------------------------------------------------------


@pytest.fixture
def bucket(tmp_path, monkeypatch):
    web = pytest.importorskip("tests.web", reason="the extra `remote` is not installed")
    (tmp_path / "empty").mkdir()
    with web.serve_bucket("out", tmp_path / "empty") as url:
        for name, value in os.environ.items():
            if name.startswith("AWS_"):
                monkeypatch.setitem(ENVIRONMENT, name, value)
        yield url


def test_files_are_uploaded(runs, bucket):
    for source in runs.rglob("*.*"):
        os.utime(source, (0, 0))  # object stores round the times of objects down to seconds
    done = run("convert", "runs", f"{bucket}/mcap/", "--jobs", 2, "--json")
    assert done.returncode == 2
    assert [each["path"] for each in json.loads(done.stdout)["written"]] == [
        f"{bucket}/mcap/a.mcap",
        f"{bucket}/mcap/deep/b.mcap",
    ]
    convert(CROSSING, "one.mcap")
    with open_recording(f"{bucket}/mcap/a.mcap") as recording:
        assert recording.info.frames == 531
    done = run("convert", "runs", f"{bucket}/mcap/", "--newer", "--json", "-q")
    assert json.loads(done.stdout)["skipped"] == [f"{bucket}/mcap/a.mcap", f"{bucket}/mcap/deep/b.mcap"]


def test_a_single_file_is_uploaded_and_not_replaced(runs, bucket):
    url = f"{bucket}/a.mcap"
    assert run("convert", "runs/a.log", url).returncode == 0
    assert error("convert", "runs/a.log", url) == f"{url}: exists already; --force replaces it"
    assert run("convert", "runs/a.log", url, "--force").returncode == 0


def test_an_error_about_an_upload_names_the_url(runs, bucket):
    assert error("convert", "runs/a.log", "s3://other/a.mcap") == "s3://other/a.mcap: cannot be written: no such bucket"
    assert error("convert", "runs/a.log", f"{bucket}/a.txt").startswith(f"{bucket}/a.txt: ")
