"""A position in a recording: what is found by seeking."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.replay import Player
from tests.replay.scripts import light, spawn

if TYPE_CHECKING:
    from tests.replay.conftest import Record


def test_a_light_state_recorded_with_the_spawn_is_found_by_seeking(record: Record) -> None:
    """A state from before, of another light with the same id, is not that of the new one."""
    signal = spawn(5, "traffic.traffic_light")
    recording = record(
        {"spawned": [signal], "light_states": [light(5, 1)]},
        {"destroyed": [(5,)]},
        {"spawned": [signal], "light_states": [light(5, 2)]},
        {},
        {"destroyed": [(5,)]},
        {"spawned": [signal]},
        {},
    )
    assert Player(recording).at(3).light_states["state"].tolist() == [2]
    assert Player(recording).at(6).light_states["state"].tolist() == []
