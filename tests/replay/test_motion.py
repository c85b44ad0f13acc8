"""The velocities in scenes and those of trajectories are those of a loop over the frames of each life."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from carla_recap import Player, open_recording
from carla_recap.replay.motion import SceneMotion
from tests.replay.scripts import pose, spawn, write
from tests.twins import motion as twin

SECONDS = st.sampled_from([0.001, 0.05, 0.05, 0.05, 0.3, 1.0, 1.5])
METRES = st.sampled_from([0.0, 1.0, 1.0, 4.9, 5.1, 14.9, 99.0, 1e4, math.nan])
SPEED = st.sampled_from([None, None, None, 0.0, 33.0, 149.0, 150.0, 1e6, math.inf, math.nan])
PRESENCE = st.sampled_from(["there"] * 6 + ["absent", "another"])


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@given(
    frames=st.lists(st.tuples(SECONDS, METRES, SPEED, PRESENCE), min_size=1, max_size=10),
    others=st.sets(st.integers(0, 9)),
    length=st.integers(1, 4),
)
@example(frames=[(0.05, 1.0, None, ("there", "absent")[row % 2]) for row in range(9)], others=set(range(9)), length=4)
def test_velocities_are_those_of_a_loop(
    suffix: str, frames: list[tuple[float, float, float | None, str]], others: set[int], length: int
) -> None:
    """Actor 1 moves; others that come and go end batches, of which `length` scenes are given at a time."""
    times = np.cumsum([0.0, *(each[0] for each in frames[1:])]).tolist()
    x = np.cumsum(np.nan_to_num([each[1] for each in frames]))
    x[np.isnan([each[1] for each in frames])] = np.nan
    x = np.float32(100 * x).astype(np.float64)
    script: list[dict[str, Any]] = []
    lives: list[list[int]] = []  # the rows of each
    for row, (_, _, speed, presence) in enumerate(frames):
        records: dict[str, Any] = {"transforms": [pose(2)] * (row in others)}
        if presence != "absent":
            records["transforms"] += [pose(1, x[row], 100)]
            records["velocities"] = [(1, speed, 0, 0, 0, 0, 0)] if speed is not None else []
            if presence == "another" or not lives:
                records["spawned"] = [spawn(1)]
            if presence == "another" or not lives:
                lives.append([])
            lives[-1].append(row)
        script.append(records)
    expected, in_scenes = np.full((2, len(frames), 3), np.nan)

    def velocities(rows: list[int]) -> list[twin.Vector]:
        places = [(x[row] * 0.01, -1.0, 0.0) for row in rows]
        known = [frames[row][2] for row in rows]
        recorded = [(math.nan if speed is None else speed, 0.0, 0.0) for speed in known]
        return twin.velocities([times[row] for row in rows], places, recorded)

    for rows in lives:
        expected[rows] = velocities(rows)
        for number, row in enumerate(rows):  # of what is behind a scene, the next frame alone is known
            in_scenes[row] = velocities([each for each in rows if each <= row + 1])[number]
            following = [*lives[lives.index(rows) + 1 :], [len(frames)]][0][0]
            for absent in range(row + 1, [*rows, following][number + 1]):
                if times[absent] - times[row] <= 1.0:
                    in_scenes[absent] = in_scenes[row]
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / f"in{suffix}", script, times=times)
        with open_recording(path) as recording:
            if lives:
                path_of = recording.trajectory(1)
                found = np.stack((path_of.vx, path_of.vy, path_of.vz), axis=1)
                np.testing.assert_allclose(found, expected[np.concatenate(lives)], rtol=1e-5, atol=1e-3)
            motion, rows = SceneMotion(), []
            for batch in Player(recording).batches():
                for first in range(0, len(batch), length):
                    part = batch[first : first + length]
                    index = part.index_of(1)
                    found = motion.velocities(part)
                    rows.append(np.full((len(part), 3), np.nan) if index is None else found[:, index])
    np.testing.assert_allclose(np.concatenate(rows), in_scenes, rtol=1e-5, atol=1e-3)
