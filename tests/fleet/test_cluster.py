"""Dask clusters, here of two worker processes on this machine."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import time
import warnings
from contextlib import contextmanager
from functools import partial

import pytest

from carla_recap.errors import MissingExtra, NoCredentials, RecapError, RecapWarning
from carla_recap.fleet.cluster import connect
from carla_recap.fleet.engine import map_sources
from carla_recap.fleet.sources import SourceFile
from tests.cli.command import CROSSING, run
from tests.fleet.hostile import HOSTILE, LIMIT, hostile
from tests.waiting import time_limit, wait_until

distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")


def sources(count):
    return [SourceFile(f"s3://bucket/{index}.log") for index in range(count)]


def slow(source):
    time.sleep(0.01)
    return os.getpid(), source.location


def picky(source):
    if source.location.endswith("3.log"):
        raise RecapError(f"{source.location}: is bad")
    warnings.warn(source.location, RecapWarning, stacklevel=1)
    return len(source.location)


def end_always(source, folder):
    """End the process with recording 20, as often as it is tried; count the attempts."""
    if source.location.endswith("/20.log"):
        (folder / str(time.monotonic_ns())).touch()
        os._exit(1)
    return source.location


def address(source):
    return source.address


def absent(source):
    warnings.warn(f"{source.address}: is odd", RecapWarning, stacklevel=1)
    raise RecapError(f"{source.address}: is absent")


def without_keys(source):
    raise NoCredentials(f"{source.location}: no credentials")


def without_extra(source):
    raise MissingExtra("video", "video")


@contextmanager
def allowed_failures(client, number):
    """Let Dask give up a task after more than a number of workers that end with it."""

    def change(dask_scheduler, number):
        before, dask_scheduler.allowed_failures = dask_scheduler.allowed_failures, number
        return before

    before = client.run_on_scheduler(change, number=number)
    yield
    client.run_on_scheduler(change, number=before)


def test_the_outcomes_are_those_of_processes(client):
    with time_limit():
        found = list(map_sources(picky, sources(50), client=client))
    assert found == list(map_sources(picky, sources(50), jobs=1))
    assert found[3].error == "s3://bucket/3.log: is bad"
    assert found[4].warnings == ("s3://bucket/4.log",)


def test_a_worker_that_is_killed_loses_no_recording(client):
    pids = set(client.run(os.getpid).values())
    with time_limit():
        outcomes = map_sources(slow, sources(300), client=client)
        first = next(outcomes)
        assert first.value[0] in pids
        os.kill(first.value[0], signal.SIGKILL)
        values = [first.value, *(outcome.value for outcome in outcomes)]
    assert [location for _, location in values] == [source.location for source in sources(300)]


def test_a_recording_that_ends_its_workers_has_an_error_and_others_have_none(client, tmp_path):
    with time_limit(), allowed_failures(client, 0):
        outcomes = list(map_sources(partial(end_always, folder=tmp_path), sources(40), client=client))
    errors = {outcome.source.location: outcome.error for outcome in outcomes if outcome.error}
    assert errors == {"s3://bucket/20.log": "s3://bucket/20.log: its worker processes end"}
    assert [outcome.source for outcome in outcomes] == sources(40)
    assert list(tmp_path.iterdir())


def test_workers_open_absolute_paths_and_messages_have_those_that_were_given(client, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (outcome,) = map_sources(address, [SourceFile("a.log")], client=client)
    assert (outcome.value, outcome.source.location) == (str(tmp_path / "a.log"), "a.log")
    (outcome,) = map_sources(absent, [SourceFile("a.log")], client=client)
    assert (outcome.error, outcome.warnings) == ("a.log: is absent", ("a.log: is odd",))


def test_what_a_worker_lacks_is_said_once(client):
    with pytest.raises(RecapError) as caught, time_limit():
        list(map_sources(without_keys, sources(40), client=client))
    assert re.fullmatch(r"the Dask worker tcp://127\.0\.0\.1:\d+: s3://bucket/\d+\.log: no credentials", str(caught.value))
    with pytest.raises(RecapError, match=r"the Dask worker tcp://[^ ]*: video needs an optional dependency"), time_limit():
        list(map_sources(without_extra, sources(40), client=client))


def test_a_module_that_workers_lack_is_said_once(client, tmp_path, monkeypatch):
    (tmp_path / "module_of_this_machine.py").write_text("def function(source):\n    return 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    from module_of_this_machine import function

    with (
        pytest.raises(RecapError, match=r"the Dask worker tcp://[^ ]*: No module named .module_of_this_machine") as caught,
        time_limit(),
    ):
        list(map_sources(function, sources(40), client=client))
    assert "\n" not in str(caught.value)


def test_answers_errors_and_relative_paths_are_printed_as_without_a_cluster(cluster, tmp_path):
    (tmp_path / "runs").mkdir()
    for name in ("a.log", "c.log"):
        shutil.copy(CROSSING, tmp_path / "runs" / name)
    (tmp_path / "runs" / "b.log").write_bytes(b"junk")
    for form in ([], ["--json"]):
        asked = ["collisions", "runs", *form]
        expected, found = (run(*asked, *more, cwd=tmp_path) for more in ([], ["--dask", cluster.scheduler_address]))
        assert (found.returncode, found.stdout, found.stderr) == (2, expected.stdout, expected.stderr)


def test_files_are_written_by_workers(cluster, tmp_path):
    shutil.copy(CROSSING, tmp_path / "a.log")
    shutil.copy(CROSSING, tmp_path / "b.log")
    done = run("convert", "a.log", "b.log", "out", "--dask", cluster.scheduler_address, "--json", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(json.loads(done.stdout)["written"]) == 2
    assert (tmp_path / "out" / "b.mcap").stat().st_size > 1000


def test_an_iterator_that_is_closed_cancels_its_tasks(client):
    outcomes = map_sources(slow, sources(3000), client=client)
    next(outcomes)
    outcomes.close()
    wait_until(lambda: not client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)))


def test_a_client_that_is_closed_is_an_error(cluster):
    with connect(cluster.scheduler_address) as client:
        outcomes = map_sources(slow, sources(3000), client=client)
        next(outcomes)
        client.close()
        with pytest.raises(RecapError, match="the Dask cluster is gone"), time_limit():
            list(outcomes)


def test_an_address_without_a_scheduler_is_an_error_in_one_line(monkeypatch):
    monkeypatch.setattr("carla_recap.fleet.cluster._PATIENCE", 0.5)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        for address in (f"tcp://127.0.0.1:{free.getsockname()[1]}", "nonsense://x"):
            with pytest.raises(RecapError, match=f"^{address}: no Dask scheduler answers .*$"):
                connect(address)


def test_a_function_with_a_limit_runs_in_children_of_workers(client):
    pids = set(client.run(os.getpid).values())
    with time_limit():
        names = ["a", "hangs", "exits", "b"]
        outcomes = list(map_sources(hostile, map(SourceFile, names), client=client, limit=LIMIT))
    assert [outcome.error for outcome in outcomes] == [HOSTILE.get(name) for name in names]
    assert pids == set(client.run(os.getpid).values())
    assert not pids & {outcome.value for outcome in outcomes}
