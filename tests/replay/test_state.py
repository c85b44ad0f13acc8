"""The state of a scene: actors, events, doors, lights, weather; and ignored actors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import open_recording
from carla_recap.model.frame import Header
from carla_recap.model.records import NO_ACTOR
from carla_recap.replay import Player
from carla_recap.replay.cursor import Cursor
from carla_recap.replay.events import Collided, Destroyed, Parented, Spawned
from carla_recap.replay.player import LiveScenes
from tests.replay.scripts import FRAMES, build, light, pose, spawn, state, velocity, x_of
from tests.samples import warnings_ignored

if TYPE_CHECKING:
    from carla_recap.replay import Scene
    from tests.replay.conftest import Record

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
    assert both is not None
    kinds = [type(event) for event in both.events]
    assert kinds == [Spawned, Parented, Collided, Destroyed, Collided]
    assert [event.elapsed for event in both.events] == [1, 1, 1, 2, 2]
    assert both.collisions[0] == Collided(1, 0, 1, 2, True, False)
    assert both.collisions[1].actor2 == NO_ACTOR
    assert both.spawned[0].actor.parent == 1, "an actor as it is at the end of its frame"
    assert both.parented == [Parented(1, 3, 1)]
    assert both.destroyed == [Destroyed(2, 2)]
    assert list(both.actors) == [1, 3]
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


# --- who is left out -----------------------------------------------------------------------------------------


def cast(record: Record, **options: bool) -> Scene:
    ids = (1, 2, 3)
    first = {
        "spawned": [HERO, spawn(2), spawn(3, "spectator")],
        "parented": [(1, 2)],
        "doors": [(1, 0, 1)],
        "transforms": [pose(id) for id in ids],
        "vehicle_controls": [(id, 0, 0, 0, 0, 1) for id in ids],
        "velocities": [velocity(id, 1) for id in ids],
    }
    scene = Player(record(first, {"transforms": [pose(id, 100) for id in ids]}), **options).tick(0.5)
    assert scene is not None
    return scene


def test_the_spectator_is_left_out_unless_it_is_asked_for(record: Record) -> None:
    scene = cast(record)
    assert scene.ids.tolist() == list(scene.actors) == scene.vehicle_controls["id"].tolist() == [1, 2]
    assert [event.actor.id for event in scene.spawned] == [1, 2]
    assert scene.doors == {1: {0}}
    assert cast(record, ignore_spectator=False).ids.tolist() == [1, 2, 3]


def test_the_hero_is_left_out(record: Record) -> None:
    scene = cast(record, ignore_hero=True)
    assert scene.ids.tolist() == list(scene.actors) == scene.velocities["id"].tolist() == [2]
    assert [event.actor.id for event in scene.spawned] == [2]
    assert scene.parented == []
    assert scene.doors == {}
    assert scene.poses[:, 0].tolist() == [50]


def test_an_ignored_id_that_another_actor_gets(record: Record) -> None:
    both = {"transforms": [pose(1)]}
    recording = record({"spawned": [HERO], **both}, {"destroyed": [(1,)]}, {"spawned": [spawn(1)], **both}, both)
    scenes = [list(scene.ids) for scene in Player(recording, ignore_hero=True).scenes()]
    assert scenes == [[], [], [1], [1]]


def test_records_of_a_destroyed_actor_do_not_count(record: Record) -> None:
    both = {"transforms": [pose(1), pose(2)]}
    recording = record({"spawned": [spawn(1), spawn(2)], **both}, {"destroyed": [(1,)], **both}, both)
    assert [scene.ids.tolist() for scene in Player(recording).scenes()] == [[1, 2], [2], [2]]


def test_actors_that_were_never_spawned_are_shown(record: Record) -> None:
    scene = Player(record({"transforms": [pose(4)]})).at(0)
    assert (scene.ids.tolist(), dict(scene.actors)) == ([4], {})
    assert scene.pose_of(4) is not None


# --- state ---------------------------------------------------------------------------------------------------


def test_open_doors_are_kept(record: Record) -> None:
    recording = record(
        {"spawned": [HERO], "doors": [(1, 0, 1), (1, 5, 1)]},
        {"doors": [(1, 0, 0)]},
        {"doors": [(1, 6, 1)]},
        {"doors": [(1, 4, 0)]},
        {"doors": [(1, 6, 0)]},
        {"doors": [(1, 1, 1)]},
        {"destroyed": [(1,)]},
    )
    doors = [scene.doors.get(1) for scene in Player(recording).scenes()]
    assert doors == [{0, 5}, {5}, {0, 1, 2, 3, 4, 5}, {0, 1, 2, 3, 5}, None, {1}, None]


def test_weather_is_kept(record: Record) -> None:
    weather = [[], [(80,) + (0,) * 13], [], [(10,) + (0,) * 13, (20,) + (0,) * 13]]
    scenes = list(Player(record(*({"weather": rows} if rows else {} for rows in weather))).scenes())
    assert scenes[0].weather is None
    assert [scene.weather["cloudiness"] for scene in scenes[1:] if scene.weather is not None] == [80, 80, 20]


def test_light_states_are_kept(record: Record) -> None:
    signals = [spawn(5, "traffic.traffic_light"), spawn(6, "traffic.traffic_light")]
    recording = record(
        {"spawned": signals, "light_states": [light(6, 1), light(5, 0)]},
        {"light_states": [light(5, 2, 1.5)]},
        {},
        {"destroyed": [(5,)]},
        {"spawned": [spawn(5, "traffic.traffic_light")]},
    )
    scenes = list(Player(recording).scenes())
    shown = [dict(zip(s.light_states["id"].tolist(), s.light_states["state"].tolist(), strict=True)) for s in scenes]
    assert shown == [{5: 0, 6: 1}, {5: 2, 6: 1}, {5: 2, 6: 1}, {6: 1}, {6: 1}]
    assert scenes[2].light_states["elapsed"].tolist() == [1.5, 0]


def test_an_actor_without_a_pose_in_a_frame_is_where_it_was_last(record: Record) -> None:
    """Also after a seek, between frames, and while it is the only one of its kind; not if another one has its id."""
    recording = record(
        {"spawned": [spawn(1), spawn(2, x=7)], "transforms": [pose(1, 100), pose(2, 9), pose(3, 50)]},
        {"transforms": [pose(1, 200), pose(2, 9)]},
        {"transforms": [pose(2, 9)]},
        {},
        {"transforms": [pose(1, 220), pose(2, 9)]},
        {"destroyed": [(1,)], "transforms": [pose(2, 9)]},
        {"spawned": [spawn(1, x=3)]},
    )
    expected = [{1: 100, 2: 9, 3: 50}, {1: 200, 2: 9}, {1: 200, 2: 9}, {1: 200, 2: 9}, {1: 220, 2: 9}, {2: 9}, {2: 9}]
    live = LiveScenes()
    for time, (played, places) in enumerate(zip(Player(recording).scenes(), expected, strict=True)):
        for scene in (played, Player(recording, start=time).tick(0.0), live.scene(list(recording)[time])):
            assert dict(zip(scene.ids.tolist(), scene.poses[:, 0].tolist(), strict=True)) == places
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


def test_light_states_of_other_actors_hold_in_their_frame_only(record: Record) -> None:
    recording = record({"light_states": [light(5, 1)]}, {"light_states": [light(6, 1)]}, {})
    assert [scene.light_states["id"].tolist() for scene in Player(recording).scenes()] == [[5], [6], []]


def test_scene_lights_are_kept(record: Record) -> None:
    def lamp(id: int, on: int) -> tuple[float, ...]:
        return (id, 10, 1, 1, 1, 1, on, 2)

    recording = record({"scene_lights": [lamp(-3, 1), lamp(4, 1)]}, {}, {"scene_lights": [lamp(-3, 0)]})
    scenes = list(Player(recording).scenes())
    assert [dict(scene.scene_lights[["id", "on"]].tolist()) for scene in scenes] == [
        {-3: 1, 4: 1},
        {-3: 1, 4: 1},
        {-3: 0, 4: 1},
    ]


def test_boxes(record: Record) -> None:
    def box(id: int, extent: float) -> tuple[float, ...]:
        return (id, 10, 20, 30, extent, extent, extent)

    recording = record(
        {"spawned": [HERO, spawn(2)], "bounding_boxes": [box(1, 100), box(2, float("nan"))]}, additional_data=True
    )
    scene = Player(recording).at(0)
    found = scene.actors[1].bounding_box
    assert found is not None
    assert (found.y, found.extent_x) == pytest.approx((-0.2, 1))
    assert scene.actors[2].bounding_box is None
    assert scene.spawned[0].actor.bounding_box == found


def test_controls_are_those_of_the_frame(record: Record) -> None:
    recording = record({"walker_controls": [(3, 140)], "vehicle_lights": [(1, 9)], "velocities": [velocity(1, 2)]}, {})
    player = Player(recording)
    scene = player.at(0.5)
    assert scene.walker_controls["speed"].tolist() == [140]
    assert scene.vehicle_lights["flags"].tolist() == [9]
    assert scene.velocities["x"].tolist() == [2]
    assert not len(player.at(1.0).walker_controls)


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
