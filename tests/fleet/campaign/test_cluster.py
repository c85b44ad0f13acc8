"""Campaigns on a Dask cluster whose workers are killed, and into an object store."""

from __future__ import annotations

import os
import signal
from functools import partial

import pytest

from carla_recap import open_recording
from carla_recap.fleet.campaign import campaign
from tests.fleet.campaign import functions
from tests.samples import names_in
from tests.waiting import time_limit
from tests.web import obstore, serve_bucket

pytest.importorskip("pymunk", reason="the extra `sim` is not installed")


def test_each_run_is_there_once_when_workers_are_killed(client, tmp_path):
    seeds, killed = range(1, 13), set()
    with time_limit():
        runs = campaign(functions.drive, seeds=seeds, params={"seconds": [0.2]}, out=tmp_path / "a", client=client)
        found = []
        for finished in runs:
            found.append(finished)
            if len(found) in (4, 8):
                pid = next(iter(client.run(os.getpid).values()))
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)
        list(campaign(functions.drive, seeds=seeds[:8], params={"seconds": [0.2]}, out=tmp_path / "b", jobs=1))
    assert len(killed) == 2
    assert [(finished.run.seed, finished.report.error) for finished in found] == [(seed, None) for seed in seeds]
    assert names_in(tmp_path / "a") == sorted(f"seed={seed},seconds=0.2.mcap" for seed in seeds)
    for name in names_in(tmp_path / "b"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_recordings_go_to_an_object_store(tmp_path):
    assert obstore is not None
    (tmp_path / "empty").mkdir()
    with serve_bucket("runs", tmp_path / "empty") as url, time_limit():
        run = partial(campaign, functions.drive, params={"seconds": [0.2]}, out=f"{url}/some/", jobs=1)
        first = list(run(seeds=[1, 2]))
        again = list(run(seeds=[1, 2, 3]))
        with open_recording(f"{url}/some/seed=3,seconds=0.2.mcap") as recording:
            assert recording.header.parameters.items() >= {"seed": "3", "seconds": "0.2"}.items()
    assert [finished.report.error for finished in (*first, *again)] == [None] * 5
    assert [finished.report.was_there for finished in again] == [True, True, False]
