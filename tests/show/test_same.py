"""One recording in Rerun, Foxglove, a video and the page: all show the same, moment for moment."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from carla_recap import check, clip, import_tracks, open_recording
from carla_recap.model.lives import ROAD_USERS
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.replay import Player
from carla_recap.rules.rule_sets import make_rules
from carla_recap.scene import opacity, style
from carla_recap.scene.captions import caption_of
from carla_recap.scene.lamps import lamps_of_vehicles, state_of_lamps
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.scene.models import MODELS
from carla_recap.show.foxglove import export_foxglove
from carla_recap.show.page import write_report
from carla_recap.show.page.samples import measure, sample
from carla_recap.show.video.film import Film
from tests.replay.scripts import light, matrix_of, pose, spawn, write
from tests.samples import SAMPLES, carla_log
from tests.scene.accidents import WALKER, accident
from tests.show.page.conftest import WITHOUT_ROADS, data, lying, marks, values_at

pytest.importorskip("rerun", reason="the extra rerun is not installed")

from carla_recap.show.rerun.entities import EVENTS, LIGHT_AHEAD, PEDALS
from carla_recap.show.rerun.export import export_rerun
from tests.show.foxglove_reader import corners, latest, read, seen, xyz
from tests.show.rerun_reader import Rrd

MOMENTS = 10
LAMPS = [material for material, finish in MATERIALS.items() if finish.glow is not None and "LAMP" not in material.name]
SIGNALS = {color: name for name, color in style.LIGHTS[:3]}
PATIENCE = 2.0  # s after which a long stop has a caption
HELD = 1.4  # s for which Rerun keeps an actor see-through, at most
LYING = 1.0  # m: a body that is not higher lies


@dataclass
class Seen:
    """What is seen of the road users at a moment.

    Attributes:
        places: The centres of their bodies in m and right-handed axes; in the page, where they are, without a height.
        yaws: Their headings in degrees.
        lamps: The colours of the lit lamps of those vehicles that have any lit.
        signals: The colours of those traffic lights that have any lit.
        lying: The walkers that lie.
        marks: Where collisions are marked.
        speed: The speed of the followed actor in m/s; None if it is unknown.
        pedals: Its throttle and brake as they are shown, if they are recorded.
        light: The colour of the traffic light ahead of it, if there is one.
        see_through: The road users that are see-through for the camera behind the followed one; in the video, also if a
            fifth less has to be hidden.
        surely_see_through: Those that also are if a fifth more has to be hidden.
    """

    places: dict[int, tuple[float, ...]] = field(default_factory=dict)
    yaws: dict[int, float] = field(default_factory=dict)
    lamps: dict[int, set[tuple[int, ...]]] = field(default_factory=dict)
    signals: dict[int, str] = field(default_factory=dict)
    lying: set[int] = field(default_factory=set)
    marks: list[tuple[float, ...]] = field(default_factory=list)
    speed: float | None = None
    pedals: tuple[float, ...] | None = None
    light: str | None = None
    see_through: set[int] = field(default_factory=set)
    surely_see_through: set[int] = field(default_factory=set)


def nowhere() -> list[dict]:
    """Return frames of cars beside the hero that brake: two whose poses are unknown, for 2 s and at either end.

    Another one is parked 499 m below the road for 2 s.
    """
    frames: list[dict] = []
    for number in range(60):
        known = [20 <= number < 40, not 20 <= number < 40]
        cars = [
            pose(id, 3000, 350 * id) if is_known else pose(id, math.nan) for id, is_known in zip((2, 3), known, strict=True)
        ]
        poses = [pose(1, 50 * number), *cars, pose(4, 3000, 350, -49900 if number < 20 else 0)]
        controls = [(1, 0.0, 0.5, 0.0, 0, 1), *((id, 0.0, 0.0, 0.7, 0, 1) for id in (2, 3, 4))]
        frames.append({"transforms": poses, "vehicle_controls": controls, "light_states": [light(9, 2)]})
    frames[0]["spawned"] = [spawn(1, role_name="hero"), *map(spawn, (2, 3, 4)), spawn(9, "traffic.traffic_light", x=4000)]
    return frames


def in_the_way() -> list[dict]:
    """Return frames of a fire engine close behind the hero, which falls back after 3 s, and a walker close ahead of it."""
    frames: list[dict] = []
    for number in range(80):
        back = 900 + 150 * max(number - 30, 0)
        frames.append({"transforms": [pose(1, 50 * number), pose(2, 50 * number - back), pose(3, 50 * number + 500)]})
    frames[0]["spawned"] = [
        spawn(1, role_name="hero"),
        spawn(2, "vehicle.carlamotors.firetruck"),
        spawn(3, "walker.pedestrian.0001"),
    ]
    return frames


def without_a_spawn() -> list[dict]:
    """Return frames of the hero, and of an actor ahead of it of which nothing but poses is recorded, from 2 s on."""
    frames: list[dict] = [{"transforms": [pose(1, 50 * number)]} for number in range(50)]
    for number in range(20, 50):
        frames[number]["transforms"].append(pose(9, 50 * number + 1500, yaw=30))
    frames[0]["spawned"] = [spawn(1, role_name="hero")]
    return frames


def lives() -> list[dict]:
    """Return frames of a walker that is hit and out of sight for a while, and of a car that becomes longer, and a walker."""
    frames: list[dict] = accident(80, speed=100)
    for number, frame in enumerate(frames):
        frame["transforms"].append(pose(7, 500, 600, yaw=50))
        if 14 <= number < 24:
            frame["transforms"][1] = pose(WALKER, 200, z=-60_000)
    for number in range(40, 50):
        del frames[number]["transforms"][2]
    frames[0]["spawned"].append(spawn(7))
    frames[30]["bounding_boxes"], frames[40]["destroyed"] = [(7, 0, 0, 100, 500, 100, 100)], [7]
    frames[50]["spawned"] = [spawn(7, "walker.pedestrian.0001")]
    return frames


def tracks() -> str:
    """Return tracks of two cars of another data set: one brakes at 6.5 m/s²."""
    rows, x, speed = ["id,time,x,y,yaw,kind"], 0.0, 20.0
    for number in range(50):
        rows.append(f"7,{number / 10:.1f},{x:.4f},0,0,vehicle")
        rows.append(f"8,{number / 10:.1f},{60 + 5 * number / 10:.4f},3.5,0,vehicle")
        speed = max(speed - 0.65 * (number >= 15), 0.0)
        x += speed / 10
    return "\n".join(rows) + "\n"


SCRIPTS = {
    "nowhere": nowhere,
    "in the way": in_the_way,
    "without a spawn": without_a_spawn,
    "lives": lives,
}


@pytest.fixture(scope="module", params=["crash", "crash from the middle", "junction", "real", "import", *SCRIPTS])
def recorded(request, tmp_path_factory):
    """A recording, and the time from which on it is shown: in the middle, while a mark is to be seen."""
    name, folder = request.param, tmp_path_factory.mktemp("same")
    if name == "real":
        path = carla_log("carla-0.9.13-lane-center.log")
    elif name == "import":
        (folder / "tracks.csv").write_text(tracks())
        path = folder / "import.mcap"
        import_tracks(folder / "tracks.csv", path)
    elif name in SCRIPTS:
        path = write(folder / "script.log", SCRIPTS[name](), tick=0.1)
    else:
        sample, path = f"{name.partition(' ')[0]}.mcap", folder / "clip.mcap"
        clip(SAMPLES / sample, path, start=10.0, duration=8.0)
    with open_recording(path) as opened:
        yield opened, next(iter(opened.collisions())).elapsed + 1.0 if "middle" in name else 0.0


@pytest.fixture(scope="module")
def exported(recorded, tmp_path_factory):
    """What is exported to Rerun and to Foxglove."""
    folder, (recording, start) = tmp_path_factory.mktemp("shown"), recorded
    export_rerun(recording, folder / "x.rrd", start=start, incidents=WITHOUT_ROADS)
    export_foxglove(recording, folder / "x.mcap", start=start, incidents=WITHOUT_ROADS)
    return folder


@pytest.fixture
def logs(exported):
    """The texts in Rerun's and in Foxglove's log, sorted."""
    rerun = [text for _, texts in Rrd(exported / "x.rrd").rows(EVENTS, "TextLog:text") for text in texts]
    return sorted(rerun), sorted(message.message for _, message in read(exported / "x.mcap")["/log"])


@pytest.fixture(scope="module")
def shown(recorded, exported):
    """What each viewer shows at ten moments."""
    folder, (recording, start) = exported, recorded
    walkers = {actor.id for actor in recording.actors.values() if actor.kind == "walker"}
    rrd, topics = Rrd(folder / "x.rrd"), read(folder / "x.mcap")
    for topic, messages in topics.items():
        topics[topic] = [(start + time, message) for time, message in messages]
    replay, _ = sample(recording, [], 0.0, 0.0, None)
    times = _moments(replay.times, np.array([time for time, _ in topics["/tf/actors"]]))
    users = {actor.id for actor in recording.actors.values() if actor.kind in ROAD_USERS} | _without_spawns(recording)
    followed = Player(recording, start=start).followed
    measured = measure(recording, [] if followed is None else [followed], replay.times)
    return times, {
        "video": [_in_video(recording, time, followed, users, walkers) for time in times],
        "rerun": [_in_rerun(rrd, time, users, walkers) for time in times],
        "foxglove": [_in_foxglove(topics, time, users, walkers) for time in times],
        "page": [_in_page(replay, measured, time, followed, users) for time in times],
    }


def _without_spawns(recording) -> set[int]:
    return {id for batch in Player(recording).batches() for id in set(batch.ids.tolist()) - set(batch.actors)}


def _moments(*times: np.ndarray) -> list[float]:
    """Return ten of the times that are among all of some others."""
    common = [time for time in times[0] if all(np.abs(other - time).min() < 1e-3 for other in times[1:])]
    assert len(common) >= MOMENTS
    return [float(common[index]) for index in np.linspace(0, len(common) - 1, MOMENTS).round().astype(int)]


def _in_video(recording, time: float, followed: int | None, users: set[int], walkers: set[int]) -> Seen:
    options = IncidentOptions(kinds=["collision"])
    shots = []
    for factor in (0.8, 1.2, 1.0):
        with pytest.MonkeyPatch.context() as patch:
            for name in ("_HIDDEN", "_COVERED"):
                patch.setattr(opacity, name, factor * getattr(opacity, name))
            player = Player(recording, start=time, follow=followed)
            film = Film(recording, player, "chase", (640, 360), shown=options)
            scene = player.tick(0)
            assert scene is not None
            shots.append(film.shot(scene))
    possibly, surely, shot = shots
    instances, read, found = shot.instances, shot.readings, Seen(speed=shot.readings.speed)
    found.see_through, found.surely_see_through = (_see_through(each.instances) & users for each in (possibly, surely))
    found.pedals = None if read.controls is None else read.controls[:2]
    found.light = None if read.light is None else style.light(read.light.state)[0]
    for row, id in enumerate(instances.ids.tolist()):
        mesh, turn = MODELS[instances.models[row]].mesh, instances.rotations[row]
        if MODELS[instances.models[row]].name == "collision mark":
            found.marks.append(tuple(instances.locations[row].tolist()))
        if MODELS[instances.models[row]].name == "traffic light" and instances.lamps[row]:
            found.signals[id] = style.light(state_of_lamps(int(instances.lamps[row])))[0]
        if id not in users:
            continue
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        middle = instances.locations[row] + turn @ (instances.half_extents[row] * (low + high) / 2)
        found.places[id] = tuple(middle.tolist())
        if id in walkers and turn[2, 2] < 0.7:
            found.lying.add(id)
        else:
            found.yaws[id] = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
        lit = {_glow(lamp) for lamp in LAMPS if int(instances.lamps[row]) >> lamp & 1 and (mesh.materials == lamp).any()}
        if lit:
            found.lamps[id] = lit
    return found


def _see_through(instances) -> set[int]:
    return set(instances.ids[instances.opacity < 1].tolist())


def _in_rerun(rrd: Rrd, time: float, users: set[int], walkers: set[int]) -> Seen:
    found = Seen()
    for id in users:
        path = f"/world/actors/{id}"
        place, vertices = rrd.place(path, time), rrd.at(path, "Mesh3D:vertex_positions", time)
        if place is None or vertices is None:
            continue
        turn, middle = matrix_of(rrd.at(path, "Transform3D:quaternion", time)[0]), _middle(np.array(vertices))
        fallen, body = rrd.at(path, "InstancePoses3D:mat3x3", time), np.eye(3)
        if fallen is not None:
            body = np.array(fallen[0]).reshape(3, 3).T
            middle = body @ middle + rrd.at(path, "InstancePoses3D:translations", time)[0]
        if id in walkers and (turn @ body)[2, 2] < 0.7:
            found.lying.add(id)
        else:
            found.yaws[id] = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
        found.places[id] = tuple(place + turn @ middle)
        faded = rrd.at(path, "Mesh3D:albedo_factor", time)
        if faded is not None and faded[0] & 0xFF < 0xFF:
            found.see_through.add(id)
        for lamp in LAMPS:
            color = rrd.at(f"{path}/lamps/{lamp.name.lower()}", "Mesh3D:albedo_factor", time)
            if color is not None and tuple(color[0].to_bytes(4, "big")[:3]) == _glow(lamp):
                found.lamps.setdefault(id, set()).add(_glow(lamp))
    for path in rrd.entities:
        state = rrd.at(path, "StateChange:state", time) if path.startswith("/signals/tl_") else None
        found.signals |= {int(path.rpartition("_")[2]): state[0]} if state and state[0] in SIGNALS.values() else {}
    (speed,), pedals = (
        rrd.at("/ego/speed_kmh", "Scalars:scalars", time) or [math.nan],
        rrd.at(PEDALS, "Scalars:scalars", time),
    )
    found.speed, found.pedals = _known(speed / 3.6), None if pedals is None else tuple(pedals)
    (light,) = rrd.at(LIGHT_AHEAD, "StateChange:state", time) or ["none"]
    found.light = None if light == "none" else light.rpartition(" ")[2]
    strips = rrd.at("/world/collisions", "LineStrips3D:strips", time) or []
    found.marks = sorted({tuple(np.mean(strip[:-1], axis=0).round(3).tolist()) for strip in strips if len(strip) > 2})
    return found


def _in_foxglove(topics, time: float, users: set[int], walkers: set[int]) -> Seen:
    found = Seen()
    transforms = {}
    for topic in ("/tf/still", "/tf/actors"):
        if any(at <= time + 1e-6 for at, _ in topics[topic]):
            transforms |= {each.child_frame_id: each for each in latest(topics[topic], time).transforms}
    for id in users:
        bodies = [seen(topics[f"/scene/{kind}"], time) for kind in ("vehicles", "walkers", "others")]
        body = next((found[f"actor {id}"] for found in bodies if f"actor {id}" in found), None)
        frame = transforms.get(f"actor {id}")
        if body is None or frame is None:
            continue
        turn, points = matrix_of([getattr(frame.rotation, axis) for axis in "xyzw"]), corners(body)
        found.places[id] = tuple(xyz(frame.translation) + turn @ _middle(points))
        if id in walkers and np.ptp((points @ turn.T)[:, 2]) < LYING:
            found.lying.add(id)
        else:
            found.yaws[id] = math.degrees(math.atan2(turn[1, 0], turn[0, 0]))
        lit = seen(topics["/scene/lamps"], time).get(f"lamps {id}")
        if lit is not None and lit.triangles:
            found.lamps[id] = {tuple(round(255 * getattr(each.color, name)) for name in "rgb") for each in lit.triangles}
    if any(at <= time + 1e-6 for at, _ in topics["/hero"]):
        hero = latest(topics["/hero"], time)
        found.speed = hero.speed if hero.HasField("speed") else None
        found.pedals = (hero.shown_throttle, hero.shown_brake) if hero.HasField("shown_brake") else None
    ahead = latest(topics["/lights"], time).ahead.text
    found.light = None if ahead == "none" else ahead.rpartition(" ")[2]
    for name, entity in seen(topics["/scene/signals"], time).items():
        color = entity.spheres[0].color
        state = SIGNALS.get(tuple(round(255 * part) for part in (color.r, color.g, color.b)))
        found.signals |= {int(name.rpartition(" ")[2]): state} if state else {}
    for entity in seen(topics["/scene/marks"], time).values():
        found.marks.append(tuple(_middle(corners(entity)).tolist()))
    return found


def _in_page(replay, measured, time: float, followed: int | None, users: set[int]) -> Seen:
    present, lamps = replay.poses(time), values_at(replay.lamps, time)
    poses = {replay.actors[index].id: pose for index, pose in present.items()}
    found = Seen(
        {id: pose[:2] for id, pose in poses.items() if id in users},
        {id: pose[2] for id, pose in poses.items()},
        lying=set(lying(replay, time)),
        marks=[tuple(place) for place in marks(replay, time)],
        speed=_known(poses[followed][3]) if followed in poses else None,
    )
    states = values_at(replay.lights, time).items()
    found.signals = {replay.actors[index].id: style.light(state)[0] for index, state in states if state < len(SIGNALS)}
    for index, flags in lamps.items():
        lit, mesh = int(lamps_of_vehicles(np.array(flags))), MODELS[replay.actors[index].look.model].mesh
        if index in present and (
            glows := {_glow(lamp) for lamp in LAMPS if lit >> lamp & 1 and (mesh.materials == lamp).any()}
        ):
            found.lamps[replay.actors[index].id] = glows
    sample_now = int(np.searchsorted(replay.times, time + 1e-4)) - 1
    for values in (each.values for each in measured if followed in poses):
        light, pedals = values["light"][sample_now], tuple(values[name][sample_now] for name in ("throttle", "brake"))
        found.light = None if math.isnan(light) else style.light(int(light))[0]
        found.pedals = None if math.isnan(sum(pedals)) else pedals
    return found


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _middle(points: np.ndarray) -> np.ndarray:
    return (points.min(axis=0) + points.max(axis=0)) / 2


def _glow(lamp: Material) -> tuple[int, ...]:
    glow = MATERIALS[lamp].glow
    assert glow is not None
    return tuple(glow)


ALL = ("rerun", "foxglove", "page")


def compared(shown, viewers=ALL):
    """Yield the viewer and the time, what a video shows, and what the viewer shows."""
    times, found = shown
    for viewer in viewers:
        for time, one, other in zip(times, found["video"], found[viewer], strict=True):
            yield (viewer, time), one, other


def test_the_same_actors_are_there(shown):
    assert any(each.places for each in shown[1]["video"])
    for where, one, other in compared(shown):
        assert set(other.places) == set(one.places), where


def test_they_are_at_the_same_places(shown):
    for where, one, other in compared(shown):
        for id, place in one.places.items():
            known = len(other.places[id])
            reach = 0.05 if known == 3 else 0.6  # the page has the locations of actors, not the centres of their bodies
            assert other.places[id] == pytest.approx(place[:known], abs=reach), (where, id)
            if id in one.yaws:
                assert math.remainder(other.yaws[id] - one.yaws[id], 360) == pytest.approx(0, abs=1.5), (where, id)


def test_the_same_lamps_are_lit(shown):
    for where, one, other in compared(shown):
        assert other.lamps == one.lamps, where


def test_traffic_lights_have_the_same_colours(shown):
    for where, one, other in compared(shown):
        assert other.signals == one.signals, where


def test_the_same_walkers_lie(shown):
    for where, one, other in compared(shown):
        assert other.lying == one.lying, where


def test_the_same_collisions_are_marked(shown):
    for where, one, other in compared(shown):
        assert len(other.marks) == len(one.marks), where
        for mark, expected in zip(sorted(other.marks), sorted(one.marks), strict=True):
            assert mark == pytest.approx(expected[: len(mark)], abs=0.05), where


def test_the_followed_actor_is_as_fast(shown):
    for where, one, other in compared(shown):
        assert (other.speed is None) == (one.speed is None), where
        if one.speed is not None:
            assert other.speed == pytest.approx(one.speed, abs=0.01), where


def test_its_pedals_and_the_light_ahead_are_the_same(shown):
    for where, one, other in compared(shown):
        assert other.light == one.light, where
        if one.pedals is not None:
            assert other.pedals == pytest.approx(one.pedals, abs=1e-6), where


def test_the_same_actors_are_see_through(shown):
    """Rerun's camera is 1.4 m higher than that of videos: what is just half hidden from one may not be from the other."""
    times, found = shown
    for index, (time, one, other) in enumerate(zip(times, found["video"], found["rerun"], strict=True)):
        held = set().union(*(found["video"][row].see_through for row in range(index) if time - times[row] < HELD))
        assert one.surely_see_through <= other.see_through <= one.see_through | held, time


def test_the_same_events_are_listed(logs):
    rerun, foxglove = logs
    assert rerun == foxglove
    assert len(rerun) > 0


def test_the_same_incidents_are_captioned_and_listed(recorded, logs, tmp_path):
    """What the page lists is in both logs in the same words, and in a caption of the video with readable names."""
    recording, start = recorded
    found = incidents(recording.reader, WITHOUT_ROADS)
    write_report(recording, tmp_path / "page", WITHOUT_ROADS, pictures="none")
    listed = [(each["text"], each["start"], each["actors"]) for each in data(tmp_path / "page", "report")["incidents"]]
    assert listed == [(each.text, round(each.start, 3), list(each.actors)) for each in found]
    for log in logs:
        assert {each.text for each in found if each.start >= start} <= set(log)
    player = Player(recording, start=start)
    film = Film(recording, player, "chase", (640, 360), rate=2.0, shown=WITHOUT_ROADS)
    captions = {caption.text for shot in film.shots() for caption in shot.readings.captions}
    assert captions <= {caption_of(each) for each in found}
    own = [each for each in found if player.followed in each.actors and start <= each.start < player.stop - PATIENCE]
    assert {caption_of(each) for each in own} <= captions


def test_something_is_to_be_compared(request, shown):
    """The recordings have what is compared: lit lamps, and that of the crash a mark."""
    name, (_, found) = request.node.name, shown
    assert any(each.lamps for each in found["video"]) or any(part in name for part in ("real", "way", "without", "lives"))
    assert any(each.marks for each in found["video"]) or "crash" not in name
    assert found["video"][0].marks or "middle" not in name
    assert found["video"][0].see_through == {1, 2} or "way" not in name


@pytest.mark.parametrize("recorded", ["without a spawn"], indirect=True, scope="module")
def test_an_actor_without_a_spawn_is_there_as_a_small_box(shown):
    times, found = shown
    for seen_by in found.values():
        assert [9 in each.places for each in seen_by] == [time > 1.95 for time in times]
        assert seen_by[-1].yaws[9] == pytest.approx(-30, abs=0.1)
    assert found["video"][-1].places[9][2] == pytest.approx(0.15)


@pytest.mark.parametrize("recorded", ["nowhere"], indirect=True, scope="module")
def test_a_car_is_there_while_its_pose_is_known(shown):
    times, found = shown
    for seen_by in found.values():
        assert [2 in each.places for each in seen_by] == [1.95 < time < 3.95 for time in times]
        assert [3 in each.places for each in seen_by] == [not 1.95 < time < 3.95 for time in times]
        assert [4 in each.places for each in seen_by] == [time > 1.95 for time in times]


def test_verdicts_and_incidents_have_the_same_states(tmp_path):
    with open_recording(SAMPLES / "crash.mcap") as recording:
        verdicts = check(recording, make_rules(collisions={"of": "hero", "max": 0}, duration={"min": 1}))
        export_rerun(recording, tmp_path / "out.rrd", start=11, duration=5, verdicts=verdicts)
        export_foxglove(recording, tmp_path / "out.mcap", start=11, duration=5, verdicts=verdicts)
    rrd, told = Rrd(tmp_path / "out.rrd"), [states for _, states in read(tmp_path / "out.mcap")["/states"]]
    for states in told:
        shown = {f"/incidents/{state.name}": state.text for state in states.incidents}
        shown |= {f"/verdicts/{state.name}": state.text for state in states.verdicts}
        assert {path: rrd.at(path, "StateChange:state", states.elapsed + 1e-6) for path in shown} == {
            path: [text] for path, text in shown.items()
        }
    broken = next(states for states in told if states.verdicts[0].text == f"fail: {verdicts[0].message}")
    assert (broken.elapsed, broken.verdicts[1].text) == (pytest.approx(12.1), "pass")
    for layout in tmp_path.glob("*.json"):
        assert '"value": "/states.verdicts[1].text"' in layout.read_text()
    assert len([*tmp_path.glob("*.json")]) == 2
