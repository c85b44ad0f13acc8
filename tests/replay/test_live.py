"""Scenes of frames as they come, compared with those of the complete recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from carla_recap import Player, open_recording
from carla_recap.replay.player import LiveScenes

SAMPLE = Path(__file__).parents[2] / "samples" / "crossing.log"


def test_live_scenes_equal_those_of_a_player() -> None:
    live = LiveScenes()
    with open_recording(SAMPLE) as recording, open_recording(SAMPLE) as again:
        scenes = Player(recording, smooth=False).scenes()
        count = 0
        for expected, frame in zip(scenes, again, strict=True):
            scene = live.scene(frame)
            assert scene.time == expected.time
            assert scene.fresh == expected.fresh
            assert scene.ids.tolist() == expected.ids.tolist()
            np.testing.assert_array_equal(scene.poses, expected.poses)
            assert scene.actors.keys() == expected.actors.keys()
            assert scene.light_states.tolist() == expected.light_states.tolist()
            if not scene.fresh:
                assert scene.events == expected.events
            count += 1
    assert count > 100
