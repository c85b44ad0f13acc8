"""Exports to Rerun, read back with Rerun's own reader."""

from __future__ import annotations

import subprocess
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from carla_recap import ActorKind, RecapError, RecapWarning, Spawn, open_recording
from carla_recap.model.lives import ROAD_USERS
from carla_recap.replay import Player
from carla_recap.roads import RoadMap, load_map
from carla_recap.scene import style
from carla_recap.scene.follow import followed_series
from tests.replay.scripts import light, pose, spawn, write
from tests.roads.towns import town
from tests.samples import CROSSING, carla_log, names_in
from tests.scene.accidents import accident

pytest.importorskip("rerun", reason="the extra rerun is not installed")


from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.show.rerun import bodies, stream, writer
from carla_recap.show.rerun.export import export_rerun
from carla_recap.show.rerun.sinks import APPLICATION
from tests.show.rerun_reader import Arrangement, Rrd

HERO, BLOCKING, WALKER, LIGHT = 100, 101, 110, 20  # of the crossing
ROADS = RoadMap(
    "Hand",
    [np.array([(0.0, 1, 0), (9, 1, 0)])],
    [np.array([(0.0, 0, 0), (9, 0, 0)])],
    [],
    [],
    [np.array([(9.0, 0, 0), (9, 1, 0)])],
)


def export(source: Path, destination: Path, **options) -> Rrd:
    with open_recording(source) as recording:
        export_rerun(recording, destination, **options)
    return Rrd(destination)


def verify(path: Path) -> None:
    import rerun_cli

    program = Path(rerun_cli.__path__[0]) / "rerun"
    subprocess.run([program, "rrd", "verify", path], check=True, capture_output=True)


@pytest.fixture(scope="module")
def crossing(tmp_path_factory):
    """The whole sample, with all cameras."""
    folder = tmp_path_factory.mktemp("crossing")
    path = folder / "crossing.rrd"
    with open_recording(CROSSING) as recording:
        played = export_rerun(recording, path, cameras=folder / "cameras")
        yield SimpleNamespace(path=path, rrd=Rrd(path), played=played, recording=recording, cameras=folder / "cameras")


# --- actors ------------------------------------------------------------------------------------------------


def test_all_frames_are_played(crossing) -> None:
    verify(crossing.path)
    assert all(chunk.num_rows for chunk in crossing.rrd.chunks)
    info = crossing.recording.info
    assert crossing.played == (info.frames, info.duration)
    assert [entry.application_id for entry in crossing.rrd.reader.recordings()] == [APPLICATION]


def test_stationary_actors_have_few_rows(crossing) -> None:
    rows = crossing.rrd.rows(f"/world/actors/{HERO}", "Transform3D:translation")
    way = crossing.recording.trajectory(HERO)
    assert 100 < len(rows) < len(way) - 100
    times = [time for time, _ in rows]
    waits = 1.1  # the hero drives off a second after the start: the last row before that is told as well
    assert times[:3] == pytest.approx([0, waits - 0.1, waits])


def test_the_hero_is_named(crossing) -> None:
    def name(id: int) -> list[str]:
        return [label for _, (label,) in crossing.rrd.rows(f"/world/actors/{id}", "Points3D:labels")]

    assert set(name(HERO)) == {f"hero {HERO}"}
    assert name(BLOCKING) == []
    assert crossing.rrd.rows(f"/world/actors/{BLOCKING}", "name")[0][1] == [f"audi.a2 {BLOCKING}"]


def test_models_have_the_recorded_colour(tmp_path: Path) -> None:
    frames = driven(2, spawned=[spawn(1, color="20,40,250"), spawn(2, color="250,40,20")])
    rrd = export(write(tmp_path / "two.log", frames), tmp_path / "two.rrd")
    for id, strongest in ((1, 2), (2, 0)):
        colors = np.array(rrd.at(f"/world/actors/{id}", "Mesh3D:vertex_colors", 0), ">u4").view(np.uint8).reshape(-1, 4)
        painted = colors[colors[:, :3].max(axis=1) > 1.5 * np.median(colors[:, :3], axis=1).clip(40)]
        assert (painted[:, :3].argmax(axis=1) == strongest).mean() > 0.6


def test_the_map_is_in_carlas_axes(crossing) -> None:
    rows = crossing.rrd.rows("/map/actors", "Points2D:positions")
    assert len(rows) == crossing.played.frames
    time, points = rows[300]
    scene = Player(crossing.recording).at(time)
    poses = zip(scene.ids.tolist(), scene.poses.tolist(), strict=True)
    there = {id: (x / 100, y / 100) for id, (x, y, *_) in poses if scene.actors[id].kind in ROAD_USERS}
    assert np.array(sorted(points)) == pytest.approx(np.array(sorted(there.values())), abs=1e-3)
    colors = crossing.rrd.rows("/map/actors", "Points2D:colors")[300][1]
    assert len(colors) == len(points)
    assert crossing.rrd.at("/map/followed", "Points2D:positions", time)[0] == pytest.approx(there[HERO], abs=1e-3)


# --- the followed actor ------------------------------------------------------------------------------------


def test_the_camera_is_at_the_hero_and_level(crossing) -> None:
    way = crossing.recording.trajectory(HERO)
    assert all(x == y == 0 for _, ((x, y, _, _),) in crossing.rrd.rows("/world/chase", "Transform3D:quaternion"))
    for time, *place, yaw in zip(way.time, way.x, way.y, way.z, way.yaw, strict=True):
        assert crossing.rrd.place("/world/chase", time) == pytest.approx(place, abs=1e-4)
        assert abs((crossing.rrd.angle("/world/chase", time) - yaw + 180) % 360 - 180) < 40


def test_plots_are_those_of_the_followed_actor(crossing) -> None:
    series, controls = followed_series(crossing.recording, HERO, {}), crossing.recording.controls(HERO)
    expected = {
        "speed_kmh": series.speed * 3.6,
        "acceleration": series.acceleration,
        "pedals": series.pedals,
        "controls": np.stack((controls.throttle, controls.brake, controls.steer), axis=1),
    }
    for name, values in expected.items():
        known = np.isfinite(values).reshape(len(values), -1).all(axis=1)
        times, found = zip(*crossing.rrd.rows(f"/ego/{name}", "Scalars:scalars"), strict=True)
        assert times == pytest.approx(series.time[known]), name
        assert np.squeeze(found) == pytest.approx(values[known], abs=1e-3), name
    assert crossing.rrd.static["/ego/controls"]["SeriesLines:names"] == ["throttle", "brake", "steer"]


def test_the_trail_is_where_it_drove(crossing) -> None:
    strips = [strip for _, (strip,) in crossing.rrd.rows(f"/world/trail/{HERO}", "LineStrips3D:strips")]
    assert all(a[1] == pytest.approx(b[0], abs=1e-4) for a, b in pairwise(strips))
    way = crossing.recording.trajectory(HERO)
    length = sum(np.linalg.norm(np.subtract(*strip)) for strip in strips)
    assert length == pytest.approx(np.linalg.norm(np.diff((way.x, way.y, way.z)), axis=0).sum(), rel=1e-3)


def test_the_blueprint_follows_the_hero(crossing) -> None:
    arrangement = Arrangement(crossing.path)
    assert arrangement.store.application_id == APPLICATION
    chase, top = arrangement.view("Chase"), arrangement.view("Top")
    assert chase.origin == top.origin == "/world/chase"
    assert chase.position == [-10, 0, 5]
    ahead = np.subtract(chase.look_target, chase.position)
    assert np.degrees(np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1]))) == pytest.approx(-17)
    assert (chase.eye_up, chase.ranged[0]) == ([0, 0, 1], f"/world/trail/{HERO}/visualizers")
    assert (top.position, top.look_target, top.eye_up) == ([0, 0, 40], [0, 0, 0], [1, 0, 0])
    assert arrangement.active_tab == "Chase"
    assert arrangement.parts["/time_panel"]["TimePanelBlueprint:timeline"] == ["sim_time"]


def test_a_camera_for_each_vehicle_and_walker(crossing) -> None:
    actors = crossing.recording.actors
    movers = {id for id in actors if actors[id].kind in ("vehicle", "walker")}
    assert {path.name for path in crossing.cameras.iterdir()} == {f"follow_{id}.rbl" for id in movers}
    for id in movers - {HERO}:
        arrangement = Arrangement(crossing.cameras / f"follow_{id}.rbl")
        assert arrangement.store.application_id == APPLICATION
        axes = arrangement.view(f"Chase {id}").origin
        way = crossing.recording.trajectory(id)
        for at in (0, len(way) // 2, len(way) - 1):
            assert crossing.rrd.place(axes, way.time[at]) == pytest.approx((way.x[at], way.y[at], way.z[at]), abs=1e-4)
    assert Arrangement(crossing.cameras / f"follow_{HERO}.rbl").view("Chase").origin == "/world/chase"


# --- lights and events -------------------------------------------------------------------------------------


def is_lit(rrd: Rrd, id: int, lamp: Material, time: float) -> bool:
    """Return whether lamps of an actor are to be seen at a time, in the colour of lit ones."""
    path = f"/world/actors/{id}/lamps/{lamp.name.lower()}"
    color, shape = (rrd.at(path, f"Mesh3D:{name}", time) for name in ("albedo_factor", "vertex_positions"))
    return shape is not None and color is not None and color[0].to_bytes(4, "big")[:3] == bytes(MATERIALS[lamp].glow)


def test_lights_change_as_recorded(crossing) -> None:
    states = crossing.recording.light_states(LIGHT)
    changed = np.flatnonzero(np.diff(states.state, prepend=-1))
    expected = [(pytest.approx(states.time[k]), [style.light(states.state[k])[0]]) for k in changed]
    assert len(expected) > 3
    assert crossing.rrd.rows(f"/signals/tl_{LIGHT}", "StateChange:state") == expected
    lamps = (Material.RED_LAMP, Material.YELLOW_LAMP, Material.GREEN_LAMP)
    for k in changed:
        lit = [lamp for lamp in lamps if is_lit(crossing.rrd, LIGHT, lamp, states.time[k])]
        assert lit == [lamps[states.state[k]]]
    assert crossing.rrd.static[f"/signals/tl_{LIGHT}"]["StateConfiguration:values"][:3] == ["red", "yellow", "green"]


def test_properties(crossing) -> None:
    about, recording = crossing.rrd.static["/__properties"], crossing.rrd.static["/__properties/recording"]
    assert about["RecordingInfo:name"] == ["crossing.log"]
    assert about["RecordingInfo:start_time"] == [int(crossing.recording.info.date.timestamp()) * 10**9]
    assert recording["map"] == ["Crossing"]
    assert recording["source"] == [str(CROSSING)]
    assert recording["recorder_version"] == [1]


def test_a_real_recording_with_its_roads(tmp_path: Path) -> None:
    roads = load_map(town("Town01"))
    path = tmp_path / "real.rrd"
    rrd = export(carla_log("carla-0.9.13-lane-center.log"), path, road_map=roads, view="top")
    verify(path)
    assert Arrangement(path).active_tab == "Top"
    points = np.concatenate(rrd.static["/map/roads"]["LineStrips2D:strips"])
    lines = np.concatenate(roads.centre_lines)[:, :2] * (1, -1)
    assert 0 < len(points) <= len(lines)
    assert np.abs(lines - points[0]).sum(axis=1).min() < 1e-3
    assert "/world/map/roads" in rrd.entities
    assert "/world/ground" not in rrd.entities


# --- special recordings ---------------------------------------------------------------------------------------


def driven(count: int, of: int = 1, **first):
    """Return frames in which an actor drives."""
    return [{"transforms": [pose(of, 100 * n)], **(first if n == 0 else {})} for n in range(count)]


def test_the_size_of_blocks_does_not_change_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = {"start": 20, "duration": 8}  # with collisions, and an actor that is destroyed
    whole = export(CROSSING, tmp_path / "whole.rrd", **part)
    for rows in (1, 3, 7):
        monkeypatch.setattr(stream, "ROWS", rows)
        monkeypatch.setattr("carla_recap.show.rerun.followed.ROWS", rows)
        rrd = export(CROSSING, tmp_path / f"{rows}.rrd", **part)
        assert rrd.entities == whole.entities
        for entity in whole.entities - {"/world/ground"}:
            for component in ("Transform3D:translation", "Transform3D:quaternion", "Scalars:scalars", "Points2D:positions"):
                found, expected = rrd.rows(entity, component), whole.rows(entity, component)
                assert [time for time, _ in found] == [time for time, _ in expected]
                for (_, one), (_, other) in zip(found, expected, strict=True):
                    assert np.ravel(one) == pytest.approx(np.ravel(other), abs=1e-6, nan_ok=True)


def test_no_actor_to_follow(tmp_path: Path) -> None:
    lamps = [spawn(id, "traffic.traffic_light", x=1000 * id) for id in (10, 30)]
    frames = [
        {"spawned": lamps, "light_states": [light(10, 2), light(30, 0)]},
        {"light_states": [light(10, 1), light(30, 0)]},
    ]
    path = tmp_path / "lights.rrd"
    rrd = export(write(tmp_path / "lights.log", frames), path)
    assert rrd.place("/world/actors/10", 0) == [100, 0, 0]
    assert not [entity for entity in rrd.entities if entity.startswith(("/ego", "/world/chase"))]
    overview = Arrangement(path).view("Overview")
    assert (overview.origin, overview.look_target) == ("/world", [200, 0, 0])
    assert len(rrd.rows("/signals/tl_30", "StateChange:state")) == 1


def test_a_light_that_is_destroyed_and_spawned_again(tmp_path: Path) -> None:
    lamp = spawn(10, "traffic.traffic_light")
    frames = [
        {"spawned": [lamp], "light_states": [light(10, 2)]},
        {"destroyed": [(10,)]},
        {"spawned": [lamp], "light_states": [light(10, 2)]},
    ]
    rrd = export(write(tmp_path / "lamp.log", frames), tmp_path / "lamp.rrd")
    assert [is_lit(rrd, 10, Material.GREEN_LAMP, t) for t in range(3)] == [True, False, True]
    assert [rrd.at("/signals/tl_10", "StateChange:state", t) for t in range(3)] == [["green"], None, ["green"]]


# --- large numbers ---


def test_boxes_are_limited_but_not_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bodies, "MOST_BOXES", 3)
    frames = [{"transforms": [pose(id, 100 * id + n) for id in range(1, 9)]} for n in range(3)]
    frames[0]["spawned"] = [spawn(id, role_name="hero" if id == 8 else "") for id in range(1, 9)]
    with pytest.warns(RecapWarning, match="from 0 s on, actors are only on the map: there are more than 3 at a time"):
        rrd = export(write(tmp_path / "many.log", frames), tmp_path / "many.rrd")
    assert {f"/world/actors/{id}" for id in (1, 2, 3, 8)} == {
        path for path in rrd.entities if path.startswith("/world/actors")
    }
    assert [len(points) for _, points in rrd.rows("/map/actors", "Points2D:positions")] == [8, 8, 8]


def test_cameras_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "MOST_CAMERAS", 2)
    source = write(tmp_path / "many.log", driven(2, spawned=[spawn(id) for id in range(1, 6)]))
    with pytest.warns(RecapWarning, match="only 2 of 5 actors get a camera"):
        export(source, tmp_path / "many.rrd", cameras=tmp_path / "cameras")
    assert names_in(tmp_path / "cameras") == ["follow_1.rbl", "follow_2.rbl"]


def test_threads_end_after_an_export(tmp_path: Path) -> None:
    source = write(tmp_path / "short.log", driven(3, spawned=[spawn(1), spawn(2)]))

    def threads() -> int:
        return psutil.Process().num_threads()

    counts = []
    for number in range(5):
        with open_recording(source) as recording:
            export_rerun(recording, tmp_path / f"{number}.rrd", cameras=tmp_path / str(number))
        counts.append(threads())
    assert counts[-1] == counts[1]


# --- the look of actors ---


def test_an_actor_that_is_not_there_for_long_can_be_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carla_recap.show.rerun.followed.ROWS", 4)
    frames = [{"transforms": [pose(2), *[pose(1, 100 * n)] * (n >= 10)]} for n in range(20)]
    frames[0]["spawned"], frames[10]["spawned"] = [spawn(2)], [spawn(1)]
    rrd = export(write(tmp_path / "x.log", frames), tmp_path / "x.rrd", follow=1)
    assert [rrd.place("/world/chase", time)[0] for time in (0, 9, 10, 15)] == [10, 10, 10, 15]


def test_an_attached_actor_leaves_its_parent_as_soon_as_its_own_poses_are_recorded(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, 100 * n), *[pose(2, 900)] * (n > 2)]} for n in range(6)]
    frames[0] |= {"spawned": [spawn(1), spawn(2, "static.prop.box", x=50)], "parented": [(2, 1)]}
    rrd = export(write(tmp_path / "x.log", frames), tmp_path / "x.rrd")
    found = [
        (rrd.at("/world/actors/2", "Transform3D:parent_frame", t), rrd.place("/world/actors/2", t)[0]) for t in (2, 3, 5)
    ]
    assert found == [(["tf#/world/actors/1"], 0.5), (["tf#/world/actors"], 9), (["tf#/world/actors"], 9)]


def test_the_camera_is_as_far_away_as_the_size_asks_that_is_recorded_after_the_spawn(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, 900)]} for _ in range(3)]
    frames[0]["spawned"], frames[1]["bounding_boxes"] = [spawn(1)], [(1, 0, 0, 100, 500, 100, 100)]
    export(write(tmp_path / "x.log", frames), tmp_path / "x.rrd")
    assert Arrangement(tmp_path / "x.rrd").view("Chase").position[0] == pytest.approx(-10 - (5 - 2.4) * 1.6)


def test_a_walker_that_lies_is_drawn_so_again_after_it_was_out_of_sight(tmp_path: Path) -> None:
    frames = accident(speed=100, walker=WALKER)
    frames[12]["transforms"][1] = pose(WALKER, 200, z=-60_000)
    rrd = export(write(tmp_path / "x.log", frames), tmp_path / "x.rrd")
    path = f"/world/actors/{WALKER}"
    assert rrd.at(path, "Mesh3D:vertex_positions", 12) is None
    lying = [rrd.at(path, f"InstancePoses3D:{name}", time) for time in (11, 15) for name in ("mat3x3", "translations")]
    assert None not in lying
    assert [np.array(each).tolist() for each in lying[2:]] == [np.array(each).tolist() for each in lying[:2]]


def test_the_plots_end_where_the_followed_actor_vanishes(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, 100 * n)]} if n not in range(4, 7) else {} for n in range(12)]
    frames[0]["spawned"], frames[4]["destroyed"], frames[7]["spawned"] = [spawn(1)], [1], [spawn(1)]
    for frame in frames:
        frame["vehicle_controls"] = [(1, 0, 0.5, 0, 0, 0)] * ("transforms" in frame)
    rrd = export(write(tmp_path / "x.log", frames), tmp_path / "x.rrd", follow=1)
    for name in ("speed_kmh", "acceleration", "controls", "pedals"):
        rows = dict(rrd.rows(f"/ego/{name}", "Scalars:scalars"))
        assert [time for time in (3, 4, 5, 6, 7) if time in rows] == [3, 4, 7][: 2 if name == "acceleration" else 3], name
        assert np.isnan(rows[4]).all(), name


def test_without_a_map_what_was_driven_along_is_road(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, 100 * n), pose(2, 3000, 50 * n)]} for n in range(40)]
    frames[0]["spawned"] = [spawn(1), spawn(2, "walker.pedestrian.0001")]
    rrd = export(write(tmp_path / "x.log", frames, tick=0.1), tmp_path / "x.rrd")
    corners = np.array(rrd.static["/world/map/corridors"]["Mesh3D:vertex_positions"])
    assert corners[:, 0].min() < 4
    assert corners[:, 0].max() > 38
    assert np.abs(corners[:, 1]).max() == pytest.approx(1.9, abs=0.01)
    assert "/world/ground" in rrd.entities


def test_a_single_wrong_pose_is_outside_the_map(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, 100 * n), pose(2, 100 * n, 500)]} for n in range(40)]
    frames[0]["spawned"] = [spawn(1), spawn(2)]
    frames[20]["transforms"][1] = pose(2, 3e8, 500)
    rrd = export(write(tmp_path / "x.log", frames, tick=0.1), tmp_path / "x.rrd")
    (edge,) = rrd.static["/map/edge"]["LineStrips2D:strips"]
    assert np.array(edge).max(axis=0) == pytest.approx((39 + 15, 5 + 15))


def test_a_map_of_another_town_is_left_out(tmp_path: Path) -> None:
    near = driven(2, spawned=[spawn(1, role_name="hero")])
    far = [{"transforms": [pose(1, 1e5)], "spawned": near[0]["spawned"]}]
    rrd = export(write(tmp_path / "near.log", near), tmp_path / "near.rrd", road_map=ROADS)
    assert "/map/roads" in rrd.entities
    with pytest.warns(RecapWarning, match="Hand: no actor is near this map, which is left out"):
        rrd = export(write(tmp_path / "far.log", far), tmp_path / "far.rrd", road_map=ROADS)
    assert "/map/roads" not in rrd.entities


# --- bad input ---------------------------------------------------------------------------------------------


def test_cameras_and_rrd_are_written_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "full" / "mine").mkdir(parents=True)
    with pytest.raises(RecapError, match="is not empty"):
        export(CROSSING, tmp_path / "w.rrd", cameras=tmp_path / "full")
    assert names_in(tmp_path) == ["full"]
    (tmp_path / "taken" / "follow_100.rbl").mkdir(parents=True)
    with pytest.raises(RecapError, match="taken: cannot be written: Is a directory"):
        export(CROSSING, tmp_path / "x.rrd", duration=1, cameras=tmp_path / "taken", force=True)
    with pytest.raises(RecapError, match="is the destination itself; a folder was expected"):
        export(CROSSING, tmp_path / "y.rrd", cameras=tmp_path / "y.rrd")
    (tmp_path / "file").touch()
    with pytest.raises(RecapError, match="is a file; a folder was expected"):
        export(CROSSING, tmp_path / "file" / "z.rrd", cameras=tmp_path / "cameras")
    assert not (tmp_path / "cameras").exists()
    assert not (tmp_path / "y.rrd").exists()


# --- the light ahead ---------------------------------------------------------------------------------------


def test_the_light_ahead_is_named(crossing) -> None:
    named = [(time, text) for time, (text,) in crossing.rrd.rows("/ego/light_ahead", "StateChange:state")]
    assert named[0] == (0, "none")
    red = next(time for time, text in named if text == f"light {LIGHT}: red")
    assert crossing.rrd.at("/world/ahead", "Points3D:labels", red) == [f"light {LIGHT}: red"]
    assert crossing.rrd.at("/world/ahead", "LineStrips3D:strips", 5) is None


def test_signs_are_drawn_where_no_map_has_them(tmp_path: Path) -> None:
    sign = Spawn(1, ActorKind.TRAFFIC_SIGN, type_id="traffic.stop")
    rrd = export(write(tmp_path / "sign.log", driven(2, of=2, spawned=[sign, spawn(2)])), tmp_path / "sign.rrd")
    assert rrd.at("/world/actors/1", "Mesh3D:vertex_positions", 0) is not None


# --- ghosts -----------------------------------------------------------------------------------------------------


def parting(
    path: Path, shift: int, *, count: int = 8, aside: int = 0, extra: bool = False, lost: float | None = None
) -> Path:
    """Write a drive of a hero, which goes aside from 4 s on, and may be lost at 5 s, and of a walker that stands."""
    frames = []
    for n in range(count):
        x = lost if lost is not None and n == 5 else 100 * n
        poses = [pose(1 + shift, x, aside if n >= 4 else 0), pose(2 + shift, 0, 500)]
        frames.append({"transforms": [*poses, *([pose(9, 0, -700)] if extra else [])]})
    frames[0]["spawned"] = [spawn(1 + shift, role_name="hero"), spawn(2 + shift, "walker.pedestrian.0001")]
    if extra:
        frames[0]["spawned"].append(spawn(9, "vehicle.mini.cooper_s"))
    return write(path, frames)


def with_ghost(folder: Path, **options) -> Rrd:
    first = parting(folder / "a.log", 0)
    with open_recording(parting(folder / "b.log", 20, **options)) as other:
        return export(first, folder / "ghost.rrd", ghost=other)


def test_a_ghost_is_shown_from_when_on_it_is_elsewhere(tmp_path: Path) -> None:
    rrd = with_ghost(tmp_path, aside=300, count=7)
    ghost = "/world/ghost/21"
    assert not {entity for entity in rrd.entities if entity.startswith("/world/ghost/") and entity != ghost}
    shown = [rrd.at(ghost, "Mesh3D:vertex_positions", t) is not None for t in range(8)]
    assert shown == [False, False, False, False, True, True, False, False]  # b has ended at 6 s
    assert rrd.place(ghost, 5) == pytest.approx((5, -3, 0))
    assert rrd.place("/world/actors/1", 5) == pytest.approx((5, 0, 0))
    (color,) = rrd.at(ghost, "Mesh3D:albedo_factor", 5)
    assert color & 255 < 128
    assert rrd.at(ghost, "Points3D:labels", 5) == ["B: hero 21"]
    assert np.ravel(rrd.at("/map/ghosts", "Points2D:positions", 5)) == pytest.approx((5, 3))
    assert not rrd.at("/map/ghosts", "Points2D:positions", 3)
    verify(tmp_path / "ghost.rrd")


@pytest.mark.parametrize("lost", [np.nan, 3e9])
def test_a_ghost_is_hidden_while_its_pose_is_unknown(tmp_path: Path, lost: float) -> None:
    rrd = with_ghost(tmp_path, aside=300, lost=lost)
    shown = [rrd.at("/world/ghost/21", "Mesh3D:vertex_positions", t) is not None for t in range(3, 7)]
    assert shown == [False, True, False, True]
    assert rrd.place("/world/ghost/21", 6) == pytest.approx((6, -3, 0))
    assert [len(points) for _, points in rrd.rows("/map/ghosts", "Points2D:positions")[-4:]] == [1, 0, 1, 1]


def test_an_actor_of_the_other_recording_alone_is_a_ghost(tmp_path: Path) -> None:
    rrd = with_ghost(tmp_path, extra=True)
    assert {entity for entity in rrd.entities if entity.startswith("/world/ghost/")} == {"/world/ghost/9"}
    assert rrd.place("/world/ghost/9", 0) == pytest.approx((0, 7, 0))


def test_the_other_recording_may_end_before_the_exported_part(tmp_path: Path) -> None:
    first = parting(tmp_path / "a.log", 0)
    with open_recording(parting(tmp_path / "b.log", 20, aside=300, count=5)) as other:
        rrd = export(first, tmp_path / "late.rrd", ghost=other, start=6)
    assert not [entity for entity in rrd.entities if entity.startswith("/world/ghost/")]


def test_how_close_others_are_is_plotted(crossing) -> None:
    times = [value for _, value in crossing.rrd.rows("/ego/times/time_to_collision", "Scalars:scalars")]
    gaps = [value for _, value in crossing.rrd.rows("/ego/distances/gap", "Scalars:scalars")]
    assert np.nanmin(np.concatenate([np.ravel(value) for value in times])) < 0.5  # it crashes
    assert np.nanmin(np.concatenate([np.ravel(value) for value in gaps])) == 0
