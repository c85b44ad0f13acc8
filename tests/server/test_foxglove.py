"""Foxglove's connection to a server: a client of the real protocol sees the world that CARLA's client changes."""

from __future__ import annotations

import signal

import pytest

from tests.cli.command import error
from tests.server.client import connect, serving, spawn
from tests.waiting import PATIENCE

pytest.importorskip("foxglove", reason="the extra foxglove-live is not installed")
pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")
pytest.importorskip("tornado", reason="tornado is not installed")

from carla_recap.show.foxglove.websocket import FoxgloveServer
from tests.show.foxglove_client import connected, decoded


def test_a_viewer_sees_what_a_client_does() -> None:
    with serving("--fps", 20, "--foxglove-port", 0) as (process, port):
        hero = spawn(connect(port).get_world(), role_name="hero")
        assert process.stdout is not None
        with connected(process.stdout.readline().strip()) as viewer:
            found = viewer.latest("/map", "/hero", "/scene/vehicles")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    assert decoded(viewer, "/hero", found["/hero"]).id == hero.id
    assert [entity.id for entity in decoded(viewer, "/scene/vehicles", found["/scene/vehicles"]).entities] == [
        f"actor {hero.id}"
    ]
    assert len(decoded(viewer, "/map", found["/map"]).entities) > 1


def test_what_is_shown_in_one_viewer_only() -> None:
    expected = "--foxglove or --rerun was expected, not both."
    assert expected in error("serve", "--port", 0, "--foxglove", "--rerun-to", "live.rrd")


def test_a_port_in_use_is_an_error_before_the_server_starts() -> None:
    with FoxgloveServer("first", 0) as server:
        port = server.address.rpartition(":")[2]
        assert error("serve", "--port", 0, "--foxglove-port", port).endswith("Address already in use")
