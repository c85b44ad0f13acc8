"""The state of a scene: actors, events, doors, lights, weather; and ignored actors."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import open_recording
from carla_recap.model.frame import Header
from carla_recap.model.records import NO_ACTOR
from carla_recap.replay import Player
from carla_recap.replay.cursor import Cursor
from carla_recap.replay.events import Collided, Destroyed, Event, Parented, Spawned
from tests.replay.conftest import Record
from tests.replay.scripts import FRAMES, build, light, pose, spawn, state, write, x_of
from tests.samples import warnings_ignored
from tests.twins import scenes as twin

HERO = spawn(1, role_name="hero")


# --- events --------------------------------------------------------------------------------------------------


def test_events_since_the_previous_scene(record: Record) -> None:
    recording = record(
        {"spawned": [HERO, spawn(2)]},
        {"spawned": [spawn(3, "sensor.other.collision")], "parented": [(3, 1)], "collisions": [(0, 1, 2, 1, 0)]},
        {"destroyed": [(2,)], "collisions": [(1, 1, NO_ACTOR, 1, 0)]},
        {"spawned": [spawn(2)]},
    )
    player = Player(recording)
    assert [event.actor.id for event in player.tick(0.5).spawned] == [1, 2]
    both = player.tick(2.0)
    assert [(type(event), event.elapsed) for event in both.events] == [
        *((kind, 1) for kind in (Spawned, Parented, Collided)),
        *((kind, 2) for kind in (Destroyed, Collided)),
    ]
    assert both.spawned[0].actor.parent == 1, "an actor as it is at the end of its frame"
    assert player.tick(0.1).events == ()
    assert [event.actor.id for event in player.tick(0.4).spawned] == [2]


def test_the_events_of_a_fresh_scene_build_up_the_state(record: Record) -> None:
    recording = record(
        {"spawned": [HERO, spawn(2)]},
        {"spawned": [spawn(3)], "parented": [(3, 1)], "destroyed": [(2,)], "collisions": [(0, 1, 2, 1, 0)]},
        {"collisions": [(1, 1, 3, 1, 0)]},
        {},
    )
    player = Player(recording, start=2.5)
    fresh = player.tick(0.0)
    assert fresh is not None
    assert fresh.fresh
    assert [event.actor.id for event in fresh.spawned] == [1, 3]
    assert [event.elapsed for event in fresh.spawned] == [0, 1]
    assert [(event.id, event.parent) for event in fresh.parented] == [(3, 1)]
    assert [event.number for event in fresh.collisions] == [1]
    assert not player.tick(0.25).fresh
    assert player.at(0.0).fresh


def test_the_first_tick_has_the_events_of_the_start_and_those_after_it(record: Record) -> None:
    recording = record({"spawned": [HERO]}, {"spawned": [spawn(2)]}, {"destroyed": [(2,)]}, {})
    scene = Player(recording, start=0.5).tick(2)
    assert scene is not None
    assert [type(event) for event in scene.events] == [Spawned, Spawned, Destroyed]


def test_old_scenes_do_not_change(record: Record) -> None:
    recording = record(
        {"spawned": [HERO], "doors": [(1, 0, 1)], "light_states": [light(5, 0)]},
        {"spawned": [spawn(2)], "parented": [(1, 2)], "doors": [(1, 1, 1)], "light_states": [light(5, 1)]},
    )
    player = Player(recording)
    first = player.tick(0)
    assert first is not None
    before = state(first)
    player.tick(1)
    assert state(first) == before


# --- state ---------------------------------------------------------------------------------------------------


def described(event: Event) -> tuple[Any, ...]:
    told = (event.actor.id,) if isinstance(event, Spawned) else astuple(event)[1:]
    return (type(event).__name__, *told)


@pytest.mark.parametrize("kind", [".log", ".mcap"])
@given(frames=st.lists(FRAMES, min_size=1, max_size=8), ignore_hero=st.booleans(), ignore_spectator=st.booleans())
def test_scenes_are_as_the_twin_has_them(
    tmp_path_factory: pytest.TempPathFactory, kind: str, frames, ignore_hero, ignore_spectator
) -> None:
    ignored = {"ignore_hero": ignore_hero, "ignore_spectator": ignore_spectator}
    expected = list(twin.scenes(frames, tick=0.5, **ignored))
    with open_recording(write(tmp_path_factory.mktemp("any") / f"any{kind}", frames, tick=0.5)) as recording:
        shown = list(Player(recording, **ignored).scenes())
    scenes = [state(scene) | {"events": list(map(described, scene.events))} for scene in shown]
    found = [{name: scene[name] for name in expected[0]} for scene in scenes]
    found[0]["events"] = expected[0]["events"]  # those that build up the state
    assert found == expected


def test_an_actor_without_a_pose_in_a_frame_is_where_it_was_last(record: Record) -> None:
    """Also between frames, and while it is the only one of its kind; not if another one has its id."""
    recording = record(
        {"spawned": [spawn(1), spawn(2, x=7)], "transforms": [pose(1, 100), pose(2, 9), pose(3, 50)]},
        {"transforms": [pose(1, 200), pose(2, 9)]},
        {"transforms": [pose(2, 9)]},
        {},
        {"transforms": [pose(1, 220), pose(2, 9)]},
        {"destroyed": [(1,)], "transforms": [pose(2, 9)]},
        {"spawned": [spawn(1, x=3)]},
    )
    assert [x_of(Player(recording).at(time)) for time in (1.5, 2.5, 3.5, 6)] == [200, 200, 210, 3]
    held = [batch.ids[batch.held].tolist() for batch in Player(recording).batches() for _ in batch]
    assert held == [[], [], [1], [1, 2], [], [], [2]]


def test_poses_are_searched_far_back(record: Record) -> None:
    frames = [{"transforms": [pose(2)]} for _ in range(200)]
    frames[0] |= {"spawned": [spawn(1), spawn(2), spawn(3, "static.prop.box", x=5), spawn(4, "walker.pedestrian.0001", x=6)]}
    frames[3] = {"transforms": [pose(1, 700), pose(3, 800)]}
    assert [x_of(Player(record(*frames), start=170.5).tick(0), id) for id in (1, 2, 3, 4)] == [700, 0, 5, 6]


def test_frames_without_a_pose_of_an_actor_are_searched_once(record: Record, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [{"transforms": [pose(2)]} for _ in range(200)]
    frames[0] |= {"spawned": [spawn(1), spawn(2)]}
    player, searched, search = Player(record(*frames)), list[float](), Cursor._last_records
    monkeypatch.setattr(Cursor, "_last_records", lambda self, *part: searched.append(part[2]) or search(self, *part))
    least = []
    for time in (150, 100, 170):
        player.at(time)
        least.append(min(searched, default=None))
        searched.clear()
    assert least == [0, None, 150]


# --- poses that are not recorded ----------------------------------------------------------------------------


def test_without_a_record_an_actor_is_where_it_was_spawned(record: Record) -> None:
    scene = Player(record({"spawned": [spawn(5, "traffic.traffic_light", x=70)]})).at(0)
    assert scene.ids.tolist() == []
    assert list(scene.pose_of(5)) == [70, 0, 0, 0, 0, 0]
    assert scene.pose_of(6) is None


def test_attached_actors_move_with_their_parent(record: Record) -> None:
    recording = record(
        {"spawned": [HERO], "transforms": [pose(1, yaw=90)]},
        {
            "spawned": [spawn(2, "sensor.camera.rgb", x=100), spawn(3, "sensor.other.imu", x=10, yaw=90)],
            "parented": [(2, 1), (3, 2)],
            "transforms": [pose(1, 100, yaw=90)],
        },
        {"transforms": [pose(1, 200, yaw=90)]},
    )
    scene = Player(recording).at(1.5)
    assert scene.pose_of(2) == pytest.approx([150, 100, 0, 0, 0, 90])
    assert scene.pose_of(3) == pytest.approx([150, 110, 0, 0, 0, 180])


def test_actors_attached_to_each_other(record: Record) -> None:
    recording = record({"spawned": [spawn(1), spawn(2)], "parented": [(1, 2), (2, 1)]})
    assert Player(recording).at(0).pose_of(1) is None


# --- starting in the middle ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [".log", ".mcap"])
@given(
    frames=st.lists(FRAMES, min_size=1, max_size=8),
    time=st.floats(0, 1),
    ticks=st.integers(1, 6),
    tick=st.sampled_from([0.5, 7.0]),
    second=st.integers(1, 8),
    ignore_hero=st.booleans(),
    smooth=st.booleans(),
)
def test_seeking_gives_the_same_scene_as_playing(
    tmp_path_factory: pytest.TempPathFactory, kind: str, frames, time, ticks, tick, second, ignore_hero, smooth
) -> None:
    """Also if the clock begins again at 0, with the frame `second`."""
    times = [tick * (index % second if index < 2 * second else index - second) for index in range(len(frames))]
    path = build(tmp_path_factory.mktemp("any") / f"any{kind}", Header("Town01", 0), frames, times=times)
    with open_recording(path) as recording, warnings_ignored():

        def new_player(start: float = 0.0) -> Player:
            return Player(recording, start=start, ignore_hero=ignore_hero, smooth=smooth)

        player = new_player()
        moment = time * player.total
        played = player.tick(0.0)
        for _ in range(ticks):
            played = player.tick(moment / ticks) or played
        assert played is not None
        moment = played.time
        expected = state(played)
        started = new_player(moment).tick(0.0)
        assert started is not None
        assert state(started) == expected
        roamer = new_player()
        roamer.at(roamer.total)
        assert state(roamer.at(moment)) == expected
        roamer.at(moment / 2)
        assert state(roamer.at(moment)) == expected, "a small leap ahead"


def test_light_states_are_searched_far_back(record: Record) -> None:
    """A state long ago, one of an earlier actor of that id, and a light that never had a state."""
    lights = [spawn(id, "traffic.traffic_light") for id in (5, 6, 7, 8)]
    frames = [{} for _ in range(200)]
    frames[0] = {"spawned": lights}
    frames[3] = {"light_states": [light(5, 1), light(6, 1), light(8, 3)]}
    frames[20] = {"destroyed": [(6,)]}
    frames[21] = {"spawned": [spawn(6, "traffic.traffic_light")]}
    frames[150] = {"light_states": [light(8, 2)]}
    frames[180] = {"light_states": [light(8, 0)]}
    recording = record(*frames)
    scene = Player(recording, start=170.5).tick(0)
    assert scene is not None
    assert scene.light_states[["id", "state"]].tolist() == [(5, 1), (8, 2)]
