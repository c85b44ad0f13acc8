"""A cluster."""

from __future__ import annotations

import pytest

from carla_recap.fleet.cluster import connect
from tests.waiting import PATIENCE


@pytest.fixture(scope="module")
def cluster():
    """A Dask cluster of two worker processes on this machine."""
    distributed = pytest.importorskip("distributed", reason="the extra `dask` is not installed")
    dask = pytest.importorskip("dask")
    options = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    patience = {"distributed.deploy.lost-worker-timeout": f"{PATIENCE} s"}  # for a killed worker to be started again
    with (
        dask.config.set(patience),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **options) as cluster,
    ):
        yield cluster


@pytest.fixture
def client(cluster):
    """A client of the cluster."""
    with connect(cluster.scheduler_address) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
        yield client
