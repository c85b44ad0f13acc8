"""The states of traffic lights over a recording, by the signals of a map."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from carla_recap import ActorKind, Spawn, create_recording, open_recording
from carla_recap.queries.measures.road_signals import RED, LightHistory
from carla_recap.roads import network as roads

GREEN = 2


def history_of(tmp_path, states, x=0.0):
    """Return the history of one light, with a state each second, and of a map with one signal at the origin."""
    with create_recording(tmp_path / "run.mcap", map_name="") as recorder:
        for number, state in enumerate(states):
            spawns = {"spawned": [Spawn(7, ActorKind.TRAFFIC_LIGHT, x=100 * x)]} if number == 0 else {}
            recorder.add_frame(float(number), light_states=[(7, 0, 0.0, state)], **spawns)
    signals = np.array([(roads.LIGHT, 0.0, 0.0)], [("kind", "i4"), ("x", "f8"), ("y", "f8")])
    with open_recording(tmp_path / "run.mcap") as recording:
        history = LightHistory(recording.reader, SimpleNamespace(signals=signals))
        for batch in recording.batches():
            history.add(batch)
    return history


def test_a_light_is_red_from_its_change_to_the_next(tmp_path):
    history = history_of(tmp_path, [GREEN, GREEN, RED, RED, RED, GREEN, GREEN])
    assert history.red(0, 2.0, 4.9, always=True) == 7
    assert history.red(0, 1.9, 3.0, always=True) is None
    assert history.red(0, 3.0, 5.0, always=True) is None
    assert history.red(0, 5.0, 6.0, always=True) is None
    assert history.red(0, 1.9, 3.0, always=False) == 7
    assert history.red(0, 5.0, 6.0, always=False) is None


@pytest.mark.parametrize(("x", "signals"), [(3.0, (0,)), (-3.0, (0,)), (3.01, ())])
def test_a_light_is_a_signal_within_three_metres(tmp_path, x, signals):
    history = history_of(tmp_path, [RED, RED], x)
    assert history.signals == signals
    assert history.red(0, 0.0, 1.0, always=True) == (7 if signals else None)
