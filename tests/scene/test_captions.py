"""Events of a recording in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from carla_recap import Player, open_recording
from carla_recap.model.records import NO_ACTOR
from carla_recap.queries.incidents import IncidentOptions
from carla_recap.scene.captions import EventText, Line, PlayedIncidents
from tests.replay.scripts import pose, spawn, write


def lines(path: Path, frames: list[dict[str, Any]]) -> list[tuple[float, Line]]:
    """Return the lines of a recording of some frames, with their times."""
    words = EventText()
    with open_recording(write(path, frames, tick=0.1)) as recording:
        return [(scene.time, line) for scene in Player(recording).scenes() for line in words.lines(scene)]


def test_a_contact_is_a_line_again_after_a_pause_and_with_another_actor_of_the_same_id(tmp_path: Path) -> None:
    contacts = {0: (1, 2), 1: (2, 1), 5: (1, 2), 20: (1, 2), 21: (1, NO_ACTOR), 22: (2, 1), 23: (1, 2)}
    frames: list[dict[str, Any]] = [{} for _ in range(30)]
    frames[0]["spawned"], frames[23]["spawned"] = [spawn(1), spawn(2)], [spawn(2)]
    for number, (at, pair) in enumerate(contacts.items()):
        frames[at]["collisions"] = [(number, *pair, 0, 0)]
    found = [(round(time, 1), line.text) for time, line in lines(tmp_path / "in.log", frames) if line.contact]
    pair = "vehicle.audi.tt (1) collides with vehicle.audi.tt (2)"
    assert found == [(0.0, pair), (2.0, pair), (2.1, "vehicle.audi.tt (1) collides with a static object"), (2.3, pair)]


def test_many_spawns_and_destructions_are_counted(tmp_path: Path) -> None:
    crowd = range(10, 20)
    frames = [{}, {"spawned": [spawn(id, "walker.pedestrian.0001") for id in crowd]}, {"destroyed": list(crowd)}]
    assert [line.text for _, line in lines(tmp_path / "in.log", frames)] == [
        "0 actors are there",
        "10 actors appear: 10 walkers",
        "10 actors disappear: 10 walkers",
    ]


def test_near_misses_that_are_found_with_the_measures_are_not_shown_unasked(tmp_path: Path) -> None:
    """A car stops 2 m before another one."""
    frames: list[dict[str, Any]] = [{"transforms": [pose(1, 75 * min(n, 40)), pose(2, 3600)]} for n in range(80)]
    frames[0]["spawned"] = [spawn(1, role_name="hero"), spawn(2)]
    with open_recording(write(tmp_path / "in.log", frames, tick=0.05)) as recording:
        asked = IncidentOptions(kinds=["near miss"]), IncidentOptions(kinds=["hard braking"])
        for options, count in zip(asked, (1, 0), strict=True):
            player = Player(recording)
            played = PlayedIncidents(player, options=options)
            list(player.batches())
            assert len(played.found()) == count
            assert played.series() is not None


def test_incidents_before_the_time_that_is_played_are_not_found(tmp_path: Path) -> None:
    frames: list[dict[str, Any]] = [{"collisions": [(n, 1, 2, 0, 0)] * (n in (5, 20))} for n in range(30)]
    frames[0]["spawned"] = [spawn(1), spawn(2)]
    with open_recording(write(tmp_path / "in.log", frames, tick=0.1)) as recording:
        for start, count in ((0.0, 2), (2.0, 1)):
            player = Player(recording, start=start)
            played = PlayedIncidents(player, options=IncidentOptions(kinds=["collision"]))
            list(player.batches())
            assert len(played.found()) == count
