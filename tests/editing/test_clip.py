from __future__ import annotations

import math
from itertools import islice
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from carla_recap import create_recording, open_recording
from carla_recap.editing.clip import clip
from carla_recap.editing.convert import convert
from carla_recap.errors import RecapError
from carla_recap.model.frame import Extent, Frame, Header, Packet
from carla_recap.model.records import ORDER, UE4, UE5, Spawn, attributes
from carla_recap.replay.player import Player
from carla_recap.replay.state import ReplayState
from tests.samples import (
    CROSSING,
    carla_log,
    images,
    listed,
    log_header,
    names_in,
    packet_payloads,
    plain,
    reading,
    save,
    small_log,
    transform,
    warnings_ignored,
    write,
)
from tests.samples import packet as packed
from tests.samples import start as frame_start
from tests.strategies import recordings, signature

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from carla_recap.model.lives import ActorLife
    from carla_recap.replay.scene import Scene

FORMATS = [(a, b) for a in (".log", ".mcap") for b in (".log", ".mcap")]


@pytest.fixture(scope="session")
def crossing(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The sample in each format."""
    other = tmp_path_factory.mktemp("crossing") / "crossing.mcap"
    convert(CROSSING, other)
    return {".log": CROSSING, ".mcap": other}


def frames_of(path: Path) -> list[Frame]:
    with reading(path) as reader:
        return list(reader.frames())


def packets_of(frame: Frame) -> list[tuple[int, bytes]]:
    return [(packet.id, bytes(packet.payload)) for packet in frame.packets]


def parent_of(actor: ActorLife, scene: Scene) -> int | None:
    """Return its parent; in the first scene only one recorded with its spawn, as others are recorded in the next frame."""
    return actor.parent if actor.attached or not scene.fresh else None


def seen(scene: Scene) -> Any:
    """All that a scene shows, but for its time."""
    return plain(
        [
            [
                (
                    actor.id,
                    actor.type_id,
                    actor.kind,
                    actor.spawn.attributes,
                    parent_of(actor, scene),
                    actor.attached,
                    actor.bounding_box,
                )
                for actor in sorted(scene.actors.values(), key=lambda actor: actor.id)
            ],
            scene.ids,
            scene.poses,
            [(id, scene.pose_of(id)) for id in sorted(scene.actors)],
            scene.light_states,
            sorted((id, sorted(doors)) for id, doors in scene.doors.items()),
            None if scene.weather is None else scene.weather.tolist(),
            scene.scene_lights,
            scene.vehicle_controls,
            scene.velocities,
        ]
    )


def assert_same_show(source: Path, cut: Path, first: float) -> None:
    """Check that a clip shows the scenes of its source, frame by frame."""
    with open_recording(source) as long, open_recording(cut) as short:
        count = short.info.frames
        scenes = islice(Player(long, start=first, ignore_spectator=False).scenes(), count)
        for scene in Player(short, ignore_spectator=False).scenes():
            shown = next(scenes)
            assert shown.time == pytest.approx(scene.time + first)
            assert seen(shown) == seen(scene)
            count -= 1
        assert count == 0


# --- a sample and real recordings ----------------------------------------------------------------------


@pytest.mark.parametrize(("suffix", "to"), FORMATS)
def test_a_clip_is_a_recording(crossing: dict[str, Path], tmp_path: Path, suffix: str, to: str) -> None:
    path = tmp_path / f"clip{to}"
    extent = clip(crossing[suffix], path, start=28.0, duration=7.0)
    assert extent == Extent(71, 71, pytest.approx(7.0))
    assert names_in(tmp_path) == [path.name]
    own, source = frames_of(path), [f for f in frames_of(CROSSING) if 28 - 1e-6 <= f.elapsed <= 35 + 1e-6]
    assert [frame.id for frame in own] == list(range(1, 72))
    assert own[0].elapsed == 0.0
    assert [frame.elapsed for frame in own] == pytest.approx([frame.elapsed - source[0].elapsed for frame in source])
    assert [frame.duration for frame in own] == [*[frame.duration for frame in source[:-1]], -1.0]
    assert [packets_of(frame) for frame in own[1:]] == [packets_of(frame) for frame in source[1:]]
    with reading(path) as reader, reading(CROSSING) as original:
        assert reader.header == Header("Crossing", original.header.date + 28)


@pytest.mark.parametrize("start", [0.0, 12.3, 24.6, 30.0, 52.9])
def test_a_clip_shows_the_same_scenes(crossing: dict[str, Path], tmp_path: Path, start: float) -> None:
    path = tmp_path / "clip.mcap"
    clip(crossing[".mcap"], path, start=start, duration=2.0)
    with reading(crossing[".mcap"]) as reader:
        frame = reader.frame_at(start)
    assert_same_show(crossing[".mcap"], path, frame.elapsed)


@pytest.mark.parametrize("name", ["carla-0.9.10-lane-center.log", "carla-0.9.13-lane-center.log"])
def test_clips_of_real_recordings(tmp_path: Path, name: str) -> None:
    source, path = carla_log(name), tmp_path / "clip.log"
    clip(source, path, start=-3.0, duration=0.5)
    with reading(source) as reader:
        frame = reader.frame_at(reader.extent().duration - 3.0)
    assert_same_show(source, path, frame.elapsed)
    with open_recording(path) as recording:
        assert recording.info.duration == pytest.approx(0.5, abs=0.1)
        assert len(recording.heroes) == 1
        assert sum(actor.kind == "traffic_light" for actor in recording.actors.values()) == 36


# --- windows -------------------------------------------------------------------------------------------


def test_all_of_it_is_the_same_bytes(tmp_path: Path) -> None:
    clip(CROSSING, tmp_path / "all.log", start=0.0)
    assert (tmp_path / "all.log").read_bytes() == CROSSING.read_bytes()


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize(("start", "duration", "ids"), [(3.0, 2.0, range(4, 12)), (0.0, 1.0, [1, 2]), (6.0, 0.0, [12, 13])])
def test_a_clip_begins_where_the_clock_comes_to_its_start_first(
    tmp_path: Path, suffix: str, start: float, duration: float, ids: Sequence[int]
) -> None:
    frames = [
        Frame(index, index + 1, float(time), 1.0, [Packet(6, UE4[6], listed(transform(index + 1)))])
        for index, time in enumerate([*range(5), *range(8)])
    ]
    source = write(tmp_path / f"source{suffix}", Header("Town01", 0), frames)
    clip(source, tmp_path / "clip.log", start=start, duration=duration)
    assert [frame["transforms"]["id"].item() for frame in frames_of(tmp_path / "clip.log")] == list(ids)


@pytest.mark.parametrize(
    ("start", "duration", "message"),
    [
        (3.5, 0.0, "nothing at 3.5 s; the recording ends at 3 s"),
        (math.nan, 0.0, "nothing at nan s"),
        (0.0, -1.0, "a duration of -1 s"),
        (0.0, math.nan, "a duration of nan s"),
    ],
)
def test_windows_outside_the_recording_are_errors(
    small: Path, tmp_path: Path, start: float, duration: float, message: str
) -> None:
    with pytest.raises(RecapError, match=message):
        clip(small, tmp_path / "clip.mcap", start=start, duration=duration)
    assert names_in(tmp_path) == [small.name]


def test_a_clip_of_an_empty_recording_is_an_error(tmp_path: Path) -> None:
    write(tmp_path / "empty.log", Header("Town01", 0), [])
    with pytest.raises(RecapError, match="has no frames"):
        clip(tmp_path / "empty.log", tmp_path / "clip.log", start=0.0)


@pytest.mark.parametrize(("name", "message"), [("small.log", "is the source itself"), ("a.txt", r"unknown format '\.txt'")])
def test_a_clip_is_a_file_of_its_own(small: Path, tmp_path: Path, name: str, message: str) -> None:
    with pytest.raises(RecapError, match=message):
        clip(small, tmp_path / name, start=0.0, force=True)
    assert names_in(tmp_path) == ["small.log"]


# --- initial state -------------------------------------------------------------------------------------


def later_frame(source: Path, path: Path, start: float = 1.0) -> Frame:
    clip(source, path, start=start)
    return frames_of(path)[0]


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_records_written_once_are_repeated_in_the_first_frame(small: Path, tmp_path: Path, suffix: str) -> None:
    before, after = frames_of(small)[0], later_frame(small, tmp_path / f"clip{suffix}")
    for name in ("parented", "doors", "light_states", "scene_lights", "weather", "bounding_boxes"):
        assert plain(after[name]) == plain(before[name])
    for name in ("trigger_volumes", "light_times", "physics"):
        assert len(before[name])
        assert plain(after[name]) == plain(before[name])
    # The car has a transform in the second frame, the walker in the first one; the light, which is attached, has none.
    moved = plain(before["spawned"])
    moved[0][2:8] = [200.0, 200.0, 50.0, 0.0, 0.0, 90.0]
    moved[1][2:8] = [300.0, -200.0, 90.0, 0.0, 0.0, 0.0]
    assert plain(after["spawned"]) == moved
    for name in ("collisions", "destroyed", "vehicle_lights"):
        assert len(after[name]) == 0
    ids = [packet.id for packet in after.packets if packet.id != 1]
    assert ids == sorted(ids, key=ORDER.index)


def test_an_actor_destroyed_before_the_first_frame(tmp_path: Path) -> None:
    """It has no records; an actor that reuses its id has only its own."""
    path = tmp_path / "own.log"
    box = {"bounding_boxes": [(1, 0, 0, 0, 1, 1, 1), (2, 0, 0, 0, 2, 2, 2)]}
    with create_recording(path, map_name="Town01", date=0, additional_data=True) as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(1, 1), Spawn(2, 1)], doors=[(1, 0, 1), (2, 3, 1)], **box)
        recorder.add_frame(1.0, destroyed=[1, 2], parented=[(1, 2)])
        recorder.add_frame(2.0, spawned=[Spawn(2, 2)])
        recorder.add_frame(3.0)
    first = later_frame(path, tmp_path / "clip.log", 3.0)
    assert [(spawn.id, spawn.kind) for spawn in first["spawned"]] == [(2, 2)]
    assert not any(len(first[name]) for name in ("doors", "parented", "bounding_boxes"))
    assert first["destroyed"]["id"].tolist() == [1]


def test_the_latest_records_are_used(tmp_path: Path) -> None:
    path = tmp_path / "own.log"
    light = {"intensity": 1.0, "red": 0, "green": 0, "blue": 0, "alpha": 0, "on": 1, "group": 0}
    with create_recording(path, map_name="Town01", date=0, additional_data=True) as recorder:
        recorder.add_frame(
            0.0,
            spawned=[Spawn(1, 1), Spawn(2, 1), Spawn(3, 3)],
            weather={"cloudiness": 1},
            scene_lights={"id": [4, 5], **light},
            doors=[(1, 6, 1), (2, 0, 1)],
            bounding_boxes=[(1, 0, 0, 0, 1, 1, 1), (2, 0, 0, 0, 2, 2, 2)],
            light_times=[(3, 1, 1, 1)],
        )
        recorder.add_frame(
            1.0,
            weather={"cloudiness": 2},
            doors=[(1, 4, 0), (1, 5, 0), (2, 0, 0)],
            bounding_boxes=[(1, 0, 0, 0, 9, 9, 9)],
            scene_lights={"id": [4], **light, "intensity": 7.0},
        )
        recorder.add_frame(2.0, bounding_boxes=[(2, 0, 0, 0, 8, 8, 8)], doors=[(1, 0, 0)], light_times=[(3, 5, 5, 5)])
        recorder.add_frame(3.0, weather={"cloudiness": 3})
    first = later_frame(path, tmp_path / "clip.log", 2.0)
    assert first["weather"]["cloudiness"].tolist() == [2]
    assert first["scene_lights"][["id", "intensity"]].tolist() == [(4, 7.0), (5, 1.0)]
    assert first["doors"].tolist() == [(1, 0, 1), (1, 1, 1), (1, 2, 1), (1, 3, 1), (1, 0, 0)]
    assert first["bounding_boxes"][["id", "extent_x"]].tolist() == [(1, 9), (2, 8)]
    assert first["light_times"].tolist() == [(3, 5, 5, 5)]
    assert later_frame(path, tmp_path / "last.log", 3.0)["weather"]["cloudiness"].tolist() == [3]


def test_lights_recorded_only_when_they_change(tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    with create_recording(path, map_name="Town01", date=0) as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(1, 3), Spawn(2, 3)], light_states=[(1, 0, 0, 2), (2, 0, 0, 0)])
        recorder.add_frame(1.0, light_states=[(2, 0, 0, 1)])
        for second in range(2, 50):
            recorder.add_frame(second)
        recorder.add_frame(50.0, light_states=[(1, 0, 0, 3)])
    first = later_frame(path, tmp_path / "clip.log", 40.0)
    assert first["light_states"][["id", "state"]].tolist() == [(1, 2), (2, 1)]
    first = later_frame(path, tmp_path / "last.log", 50.0)
    assert sorted(first["light_states"][["id", "state"]].tolist()) == [(1, 3), (2, 1)]


def test_an_actor_without_a_pose_in_the_first_frame_is_where_it_was_last(tmp_path: Path) -> None:
    path = tmp_path / "own.log"
    with create_recording(path, map_name="Town01", date=0) as recorder:
        recorder.add_frame(
            0.0, spawned=[Spawn(1, 1), Spawn(2, 1)], transforms=[(1, 100, 0, 0, 0, 0, 0), (2, 9, 0, 0, 0, 0, 0)]
        )
        recorder.add_frame(1.0, transforms=[(1, 500, 0, 0, 0, 0, 90), (2, 9, 0, 0, 0, 0, 0)])
        for second in range(2, 30):
            recorder.add_frame(second, transforms=[(2, 9, 0, 0, 0, 0, 0)])
    first = later_frame(path, tmp_path / "clip.log", 28.0)
    assert [(spawn.id, spawn.x, spawn.yaw) for spawn in first["spawned"]] == [(1, 500.0, 90.0), (2, 9.0, 0.0)]


def test_more_destroyed_actors_than_a_packet_holds(tmp_path: Path) -> None:
    path = tmp_path / "own.log"
    with create_recording(path, map_name="Town01", date=0) as recorder:
        recorder.add_frame(0.0, destroyed=list(range(35_000)))
        recorder.add_frame(1.0, destroyed=list(range(35_000, 70_000)))
        recorder.add_frame(2.0)
    first = later_frame(path, tmp_path / "clip.mcap", 2.0)
    assert first["destroyed"]["id"].tolist() == list(range(70_000))


@pytest.mark.parametrize("parent", [1, 2, 3])
def test_an_actor_with_a_late_parent_keeps_its_pose_in_the_world(tmp_path: Path, parent: int) -> None:
    """To a car that drives away, to itself, and in a ring."""
    path = tmp_path / "own.log"
    with create_recording(path, map_name="Town01", date=0) as recorder:
        spawned = [Spawn(1, 1), Spawn(2, 5, x=6000.0), Spawn(3, 5, y=70.0)]
        recorder.add_frame(0.0, spawned=spawned, transforms=[(1, 0, 0, 0, 0, 0, 0)])
        recorder.add_frame(1.0, parented=[(2, parent), (3, 2)], transforms=[(1, 500, 0, 0, 0, 0, 0)])
        for second in range(2, 5):
            recorder.add_frame(second, transforms=[(1, second * 500, 0, 0, 0, 0, 0)])
    for start in (1.0, 2.0):  # together with it, and later
        clip(path, tmp_path / "clip.log", start=start, force=True)
        first, second, third = frames_of(tmp_path / "clip.log")[:3]
        assert [len(frame["parented"]) for frame in (first, second, third)] == [0, 2, 0]
        assert dict(second["parented"].tolist()) == {2: parent, 3: 2}
        with open_recording(path) as long, open_recording(tmp_path / "clip.log") as short:
            assert short.actors[2].parent == parent
            for scene in Player(short).scenes():
                shown = Player(long).at(scene.time + start)
                assert plain([scene.pose_of(id) for id in (1, 2, 3)]) == plain([shown.pose_of(id) for id in (1, 2, 3)])


def test_an_actor_with_a_late_parent_that_is_destroyed_next(tmp_path: Path) -> None:
    """No parent is recorded if it is destroyed or spawned again in the second frame."""
    path = tmp_path / "own.log"
    with create_recording(path, map_name="Town01", date=0) as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(id, 1) for id in (1, 2, 3, 4)])
        recorder.add_frame(1.0, parented=[(2, 1), (3, 1), (4, 1)])
        recorder.add_frame(2.0)
        recorder.add_frame(3.0, destroyed=[2], spawned=[Spawn(3, 1)], parented=[(4, 3)])
    clip(path, tmp_path / "clip.log", start=2.0)
    assert frames_of(tmp_path / "clip.log")[1]["parented"].tolist() == [(4, 1), (4, 3)]
    assert_same_show(path, tmp_path / "clip.log", 2.0)


# --- headers and dialects ------------------------------------------------------------------------------


def test_the_dialect_is_kept(tmp_path: Path) -> None:
    for wide, shifted in ((True, False), (False, True), (True, True)):
        header = Header("Town10HD", 1_000, 2, wide, shifted)
        table = header.table
        spawned = table.named("spawned")
        spawn = Packet(spawned.id, spawned, records=[Spawn(7, 1, x=1e12 if wide else 5.0)])
        frames = [
            Frame(n, n + 1, float(n), 1.0, [*([spawn] if n == 0 else []), *signature(wide=wide, shifted=shifted)])
            for n in range(4)
        ]
        source = write(tmp_path / f"{wide}{shifted}.log", header, frames)
        for suffix in (".log", ".mcap"):
            path = tmp_path / f"clip{wide}{shifted}{suffix}"
            clip(source, path, start=2.0)
            with reading(path) as reader:
                assert reader.header == Header("Town10HD", 1_002, 2, wide, shifted)
                assert [(s.id, s.x) for s in next(reader.frames())["spawned"]] == [(7, 1e12 if wide else 5.0)]


def test_a_frame_without_a_known_packet_in_a_wide_recording(tmp_path: Path) -> None:
    spawned, transforms = UE5.named("spawned"), UE5.named("transforms")
    frames = [
        Frame(0, 1, 0.0, 1.0, [Packet(2, spawned, records=[Spawn(7, 1)])]),
        Frame(1, 2, 1.0, 1.0, [Packet(200, None, b"a fork's own")]),
        Frame(2, 3, 2.0, -1.0, [Packet(6, transforms, records=transforms.records([(7, 1, 2, 3, 4, 5, 6)]))]),
    ]
    source = write(tmp_path / "wide.mcap", Header("Town01", 0, wide=True), frames)
    clip(source, tmp_path / "clip.log", start=1.0)
    with reading(tmp_path / "clip.log") as reader:
        assert reader.header.wide
        first = next(reader.frames())
    assert [packet.id for packet in first.packets] == [200, 2]
    assert [spawn.id for spawn in first["spawned"]] == [7]


def test_packets_before_the_first_frame_are_applied(tmp_path: Path) -> None:
    payloads = [packed(id, payload) for id, payload in packet_payloads()]
    frames = [frame_start(5, 1.0, 1.0), packed(6, listed(transform(7, 9))), frame_start(6, 2.0)]
    source = save(tmp_path / "early.log", b"".join([log_header(), *payloads, *frames]))
    clip(source, tmp_path / "clip.log", start=0.0)
    own = frames_of(tmp_path / "clip.log")
    assert [(frame.id, frame.elapsed, frame.preamble) for frame in own] == [(1, 0.0, False), (2, 1.0, False)]
    assert [(spawn.id, spawn.x) for spawn in own[0]["spawned"]][:2] == [(7, 9.0), (8, 300.0)]


def test_a_date_out_of_range_is_kept(tmp_path: Path) -> None:
    latest = (1 << 63) - 1
    source = save(tmp_path / "late.log", small_log())
    with reading(source) as reader:
        frames = list(reader.frames())
    write(tmp_path / "latest.log", Header("Town01", latest), frames)
    clip(tmp_path / "latest.log", tmp_path / "clip.log", start=2.0)
    with reading(tmp_path / "clip.log") as reader:
        assert reader.header.date == latest


# --- any recording -------------------------------------------------------------------------------------


def worlds(path: Path, first: int = 0) -> list[Any]:
    """Return the actors after each frame, and its transforms; `first`: the frame without late parents."""
    with reading(path) as reader:
        world = ReplayState(reader.header.table, ignore_hero=False, ignore_spectator=False)
        found = []
        for frame in reader.frames():
            world.apply(frame)
            there = {
                id: (
                    actor.kind,
                    actor.spawn.attributes,
                    actor.parent if actor.attached or frame.index != first else None,
                    actor.attached,
                )
                for id, actor in world.actors.items()
            }
            doors = sorted((id, sorted(open)) for id, open in world.doors.items() if id in there)
            found.append(plain([sorted(there.items()), frame["transforms"], doors, world.scene_lights]))
        return found


def window(path: Path, start: float, duration: float) -> list[int]:
    """The indices of the frames that a clip should have."""
    frames = frames_of(path)
    later = next((index for index, frame in enumerate(frames) if frame.elapsed > start + 1e-6), len(frames))
    first = frames[max(later - 1, 0)]
    if first.preamble:
        first = next(frame for frame in frames if not frame.preamble)
    with reading(path) as reader:
        stop = min(start + duration, reader.extent().duration) if duration else math.inf
    indices = [first.index]
    for frame in frames[first.index :]:
        if stop < math.inf and frame.elapsed >= stop + 1e-6:
            break
        if frame.index > first.index:
            indices.append(frame.index)
    return indices


def without_parents(packets: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """The packets of a frame but for those that a clip's second frame may tell more in."""
    return [packet for packet in packets if packet[0] != UE4.named("parented").id]


def check_any(source: Path, path: Path, start: float, duration: float) -> None:
    try:
        clip(source, path, start=start, duration=duration, force=True)
    except RecapError as error:
        assert "nothing at" in str(error) or "has no frames" in str(error)  # noqa: PT017
        return
    with reading(source) as one, reading(path) as other:
        # In a log, the dialect is found from its packets alone, and those with surplus bytes may mislead.
        assume((one.header.wide, one.header.shifted) == (other.header.wide, other.header.shifted))
    indices = window(source, start, duration)
    here, there = images(source), images(path)
    own, original = [found[-1] for found in there[1:]], [here[index][-1] for index in indices[1:]]
    assert own[1:] == original[1:]
    assert [without_parents(packets) for packets in own[:1]] == [without_parents(packets) for packets in original[:1]]
    before, after = worlds(source, first=indices[0]), worlds(path)
    assert after == [before[index] for index in indices]


seconds = st.one_of(st.floats(0, 20), st.sampled_from([0.0, 1.0, 2.5]))
suffixes = st.sampled_from([".log", ".mcap"])


@pytest.mark.filterwarnings("ignore::carla_recap.errors.RecapWarning")
@given(recordings(), seconds, seconds, suffixes, suffixes)
def test_any_recording(
    tmp_path: Path, recording: tuple[Header, list[Frame]], start: float, duration: float, suffix: str, to: str
) -> None:
    with warnings_ignored():
        source = write(tmp_path / f"source{suffix}", *recording)
        check_any(source, tmp_path / f"clip{to}", start, duration)


ids = st.integers(1, 5)
spawns = st.builds(
    lambda id, kind, role: Spawn(id, kind, type_id="vehicle.a", attributes=attributes(role_name=role)),
    ids,
    st.integers(0, 5),
    st.sampled_from(["hero", "other"]),
)
happenings = st.fixed_dictionaries(
    {},
    optional={
        "spawned": st.lists(spawns, max_size=2, unique_by=lambda spawn: spawn.id),
        "destroyed": st.lists(ids, max_size=2, unique=True),
        "parented": st.lists(st.tuples(ids, ids), max_size=2),
        "doors": st.lists(st.tuples(ids, st.integers(0, 6), st.integers(0, 1)), max_size=3),
        "transforms": st.lists(st.tuples(ids, *[st.integers(-9, 9)] * 6), max_size=4),
        "scene_lights": st.lists(st.tuples(ids, *[st.integers(0, 1)] * 7), max_size=2),
        "bounding_boxes": st.lists(st.tuples(ids, *[st.integers(1, 9)] * 6), max_size=2),
    },
)


@given(st.lists(happenings, min_size=1, max_size=12), st.integers(0, 11), st.integers(0, 12), suffixes, suffixes)
def test_any_history(tmp_path: Path, frames: list[dict[str, Any]], start: int, duration: int, suffix: str, to: str) -> None:
    """Actors come, go and come again with the same ids."""
    source = tmp_path / f"source{suffix}"
    with create_recording(source, map_name="Town01", date=0, additional_data=True) as recorder:
        for number, records in enumerate(frames):
            recorder.add_frame(number / 2, **records)
    check_any(source, tmp_path / f"clip{to}", start / 2, duration / 2)


poses = st.tuples(*[st.integers(-900, 900)] * 3, *[st.integers(-179, 180)] * 3)
standing = st.builds(lambda id, pose: Spawn(id, 1, *pose, type_id="vehicle.a"), ids, poses)
changes = st.fixed_dictionaries(
    {"transforms": st.tuples(poses, poses)},
    optional={
        "spawned": st.lists(standing, max_size=3, unique_by=lambda spawn: spawn.id),
        "destroyed": st.lists(ids, max_size=1),
        "parented": st.lists(st.tuples(ids, ids), max_size=3),
    },
)


@given(st.lists(changes, min_size=2, max_size=8), st.integers(0, 7), st.integers(0, 8), suffixes)
def test_any_scene(tmp_path: Path, frames: list[dict[str, Any]], start: int, duration: int, suffix: str) -> None:
    """Actors 1 and 2 always have transforms, even when they are destroyed; others stand, or ride on their parents."""
    source, path = tmp_path / "source.log", tmp_path / f"clip{suffix}"
    start = min(start, len(frames) - 1)
    with create_recording(source, map_name="Town01", date=0) as recorder:
        for number, records in enumerate(frames):
            moving = [(id, *pose) for id, pose in enumerate(records["transforms"], 1)]
            recorder.add_frame(number / 2, **records | {"transforms": moving})
    clip(source, path, start=start / 2, duration=duration / 2, force=True)
    assert_same_show(source, path, start / 2)
