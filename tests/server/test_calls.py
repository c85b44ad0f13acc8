"""The registry of calls against the client: everything that it can call is there."""

from __future__ import annotations

import tomllib

import carla
import pytest

import carla_recap.server.calls  # noqa: F401  (registers the calls)
from carla_recap.server.calls.unsupported import CallSupport, call_support
from carla_recap.server.rpc.registry import CALLS
from tests.samples import ROOT

METHODS = tomllib.loads((ROOT / "tools" / "client-methods.toml").read_text("utf-8"))


@pytest.mark.parametrize("name", METHODS)
def test_every_call_of_the_client_is_served(name: str) -> None:
    calls = METHODS[name].get("calls", {})
    methods = {method for method in vars(getattr(carla, name)) if not method.startswith("_")}
    assert methods == {*calls, *METHODS[name]["alone"]}
    assert {call for made in calls.values() for call in made if "." not in call} <= CALLS.keys()


def test_every_unsupported_call_has_a_reason() -> None:
    support = call_support()
    assert set(support) == set(CALLS)
    assert all(bool(reason) == (found is not CallSupport.SUPPORTED) for found, reason in support.values())
    assert support["draw_debug_shape"] == (CallSupport.ACCEPTED, "nothing is drawn")
    assert support["tick_cue"] == (CallSupport.SUPPORTED, "")
    assert [name for name, (found, _) in support.items() if found is CallSupport.REFUSED] == ["get_gbuffer_token"]
