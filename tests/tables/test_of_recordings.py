"""Tables and trajectories of recordings, compared with their frames, in both formats."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from carla_recap import FormatError, RecapError, RecordError, Recording, create_recording, open_recording
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.layout import Many
from carla_recap.model.records import CM, UE4, Bone, Bones, Physics
from carla_recap.tables.trajectories import Trajectory
from carla_recap.util.text import readable
from tests import strategies
from tests.samples import (
    CROSSING,
    END,
    image,
    listed,
    log_header,
    packet,
    plain,
    save,
    small_log,
    start,
    transform,
    warnings_ignored,
    write,
)

both_formats = pytest.mark.parametrize("suffix", [".log", ".mcap"])


def same(found: Any, truth: Any) -> bool:
    """Whether values are equal, NaN to itself."""
    return bool(plain(found) == plain(truth))


# --- tables ------------------------------------------------------------------------------------------------------


def rows_of_frames(recording: Recording, name: str) -> list[dict[str, Any]]:
    """The rows of a table, from the frames one by one."""
    type = recording.header.table.named(name)
    return [
        {
            "frame": frame.id,
            "time": frame.elapsed,
            **{field: value(kind, record, field) for field, kind in type.layout.fields.items()},
        }
        for frame in recording
        for record in frame[name]
    ]


def value(kind: str | Many, record: Any, field: str) -> Any:
    found = record[field].item() if isinstance(record, np.void) else getattr(record, field)
    if isinstance(kind, Many):
        return [items(kind, item) for item in found]
    if kind == "text":
        return readable(found)
    return bool(found) if kind == "flag" else found


def items(kind: Many, item: Any) -> dict[str, Any]:
    names = (item.dtype.names or ()) if isinstance(item, np.void) else kind.layouts[0].fields
    return {name: value(kind.layouts[0].fields[name], item, name) for name in names}


def rows_of_table(recording: Recording, name: str) -> list[dict[str, Any]]:
    table = recording.table(name)
    columns = {field: list(values) for field, values in table.columns().items()}
    assert {len(column) for column in columns.values()} == {len(table)}
    rows = zip(*columns.values(), strict=True)
    return [{n: v.item() if isinstance(v, np.generic) else v for n, v in zip(columns, row, strict=True)} for row in rows]


def bones() -> tuple[Header, list[Frame]]:
    """Names of different lengths with the same sum, so that packets of one size differ; in some frames two packets."""
    type = UE4.named("walker_bones")

    def packet(n: int, id: int, names: str) -> Packet:
        return Packet(type.id, type, records=[Bones(id, [Bone(name, n, id, 0, 0, 0, 0) for name in names.split()])])

    pairs = ("ab c", "ab c", "a bc", "a bc", "x yz", "ab c")
    frames = [[packet(n, id, pair) for id in ((7, 8) if n > 2 else (7,))] for n, pair in enumerate(pairs)]
    return Header("T", 0), [Frame(n, n + 1, float(n), 1.0, packets) for n, packets in enumerate(frames)]


@given(strategies.recordings(), st.sampled_from([".log", ".mcap"]))
@example(bones(), ".log")
@example(bones(), ".mcap")
@settings(max_examples=25, deadline=None)
def test_a_table_contains_the_records_of_the_frames(recorded: tuple[Header, list[Frame]], suffix: str) -> None:
    with TemporaryDirectory() as folder, warnings_ignored():
        path = write(Path(folder) / f"run{suffix}", *recorded)
        with open_recording(path) as recording:
            for type in recording.header.table[2:]:
                assert repr(rows_of_table(recording, type.name)) == repr(rows_of_frames(recording, type.name))  # NaN is NaN
            assert [image(frame) for batch in recording.batches() for frame in batch] == [image(f) for f in recording]


@both_formats
def test_the_table_of_frames(tmp_path: Path, suffix: str) -> None:
    with open_recording(save(tmp_path / "small.log", small_log())) as recording:
        path = write(tmp_path / f"own{suffix}", recording.header, recording.frames())
    with open_recording(path) as recording:
        table = recording.table("frame")
        assert table["id"].tolist() == table["frame"].tolist() == [1, 2, 3, 4]
        assert table["elapsed"].tolist() == table.time.tolist() == [0, 1, 2, 3]
        assert table["duration"].tolist() == [1, 1, 1, -1]


def test_packets_before_the_first_frame_are_not_in_the_table_of_frames(tmp_path: Path) -> None:
    data = log_header() + packet(6, listed(transform(3))) + start(1, 0.0) + packet(6, listed(transform(4))) + END
    with open_recording(save(tmp_path / "early.log", data)) as recording:
        assert recording.table("frame")["id"].tolist() == [1]
        assert recording.table("transforms")["id"].tolist() == [3, 4]
        assert recording.table("transforms").frame.tolist() == [0, 1]


@both_formats
def test_fields_that_a_build_omits_are_null_in_arrow(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("pyarrow", reason="the extra `arrow` is not installed")
    type = UE4.named("physics")
    kind = type.layout.fields["wheels"]
    assert isinstance(kind, Many)
    frames = []
    for n, layout in enumerate(kind.layouts):
        wheels = np.zeros(2, layout.dtype(wide=False))
        wheels["radius"] = n + 1
        curve = np.empty(0, [("x", "f4"), ("y", "f4")])
        physics = Physics(7, *[0.0] * 5, 0, *[0.0] * 7, curve, curve, curve, wheels)
        frames.append(Frame(n, n + 1, float(n), 1.0, [Packet(type.id, type, records=[physics])]))
    with open_recording(write(tmp_path / f"wheels{suffix}", Header("T", 0), frames)) as recording:
        table = recording.table("physics")
        assert ["lat_stiff_value" in wheels[0] for wheels in table["wheels"]] == [True, False]
        rows = table.to_arrow().column("wheels").to_pylist()
        assert [wheels[1]["radius"] for wheels in rows] == [1, 2]
        assert [wheels[1]["lat_stiff_value"] for wheels in rows] == [0, None]


@both_formats
def test_an_empty_recording_has_empty_tables(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"empty{suffix}"
    with create_recording(path, map_name="T"):
        pass
    with open_recording(path) as recording:
        for type in UE4:
            table = recording.table(type.name)
            assert len(table) == 0
            assert list(table.columns()) == ["frame", "time", *type.layout.fields]
        assert recording.trajectories() == {}
        assert list(recording.trajectories().columns())[:2] == ["id", "time"]
        assert list(recording.batches()) == []


def test_an_unknown_record_type_is_an_error() -> None:
    with (
        open_recording(CROSSING) as recording,
        pytest.raises(RecordError, match="no record type 'wings'; there are frame, "),
    ):
        recording.table("wings")


@pytest.mark.parametrize("payload", [b"", b"\1", listed(transform(7))[:-1]], ids=["nothing", "half a count", "too short"])
def test_a_packet_that_is_too_short_is_an_error_with_its_offset(tmp_path: Path, payload: bytes) -> None:
    data = log_header() + b"".join(start(n, n - 1.0) + packet(6, payload) + END for n in range(1, 6))
    with open_recording(save(tmp_path / "short.log", data)) as recording:
        for ask in (lambda: recording.table("transforms"), recording.trajectories):
            with pytest.raises(FormatError, match=r"short\.log: byte \d+: transforms: .* need"):
                ask()


# --- batches -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[".log", ".mcap"])
def crossing(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recording]:
    path = CROSSING
    if request.param == ".mcap":
        path = tmp_path_factory.mktemp("tables") / "crossing.mcap"
        with open_recording(CROSSING) as source:
            write(path, source.header, source.frames())
    with open_recording(path) as recording:
        yield recording


@pytest.mark.parametrize("window", [(-math.inf, math.inf), (20.0, 21.0), (52.9, 60.0), (10.0, 10.0)])
def test_batches_are_the_frames(crossing: Recording, window: tuple[float, float]) -> None:
    frames = [image(frame) for frame in crossing.frames(*window)]
    batches = list(crossing.batches(None, *window))
    assert [image(frame) for batch in batches for frame in batch] == frames
    assert [image(batch.frame(row)) for batch in batches for row in range(len(batch))] == frames
    assert [image(frame) for batch in batches for frame in (*batch[:1], *batch[1:])] == frames
    assert len(batches) <= max(len(frames) // 4, 1)


def test_batches_of_some_types(crossing: Recording) -> None:
    batches = list(crossing.batches(("transforms", "velocities")))
    rows = [row.tolist() for batch in batches for row in batch.records("transforms")]
    assert rows == [frame["transforms"].tolist() for frame in crossing]
    names = {column.type.name for batch in batches for column in batch.columns if column.type}
    assert names == {"transforms", "velocities"}
    assert batches[0].records("collisions").shape == (len(batches[0]), 0)


@pytest.mark.parametrize("name", ["wings", "spawned"])
def test_records_of_variable_size_are_an_error(crossing: Recording, name: str) -> None:
    with pytest.raises(RecordError, match=name):
        next(crossing.batches()).records(name)


# --- trajectories ------------------------------------------------------------------------------------------------


def poses_of(recording: Recording, id: int) -> list[Any]:
    """Time and pose of an actor from the frames one by one, the last of each frame, and its velocity if it is recorded."""
    found = []
    for frame in recording:
        rows = [row for row in frame["transforms"].tolist() if row[0] == id]
        speeds = [row for row in frame["velocities"].tolist() if row[0] == id]
        if rows:
            found.append((frame.elapsed, rows[-1][1:], speeds[-1][1:4] if speeds else None))
    return found


def check(recording: Recording, id: int, path: Trajectory) -> None:
    truth = poses_of(recording, id)
    assert same(path.time.tolist(), [time for time, _, _ in truth])
    for number, (name, factor) in enumerate({"x": CM, "y": -CM, "z": CM, "roll": 1.0, "pitch": -1.0, "yaw": -1.0}.items()):
        assert same(getattr(path, name).tolist(), [pose[number] * factor for _, pose, _ in truth])
    assert path.velocity_recorded.tolist() == [speed is not None for _, _, speed in truth]
    for number, (name, factor) in enumerate({"vx": 1.0, "vy": -1.0, "vz": 1.0}.items()):
        recorded = [speed[number] * factor for _, _, speed in truth if speed is not None]
        assert same(getattr(path, name)[path.velocity_recorded].tolist(), recorded)


@given(st.data())
@settings(max_examples=25, deadline=None)
def test_trajectories_contain_the_poses_of_the_frames(data: st.DataObject) -> None:
    """Ids that repeat, in a frame and later; velocities in some frames only."""
    ids = st.lists(st.integers(1, 4), max_size=5)
    frames = data.draw(st.lists(st.tuples(ids, ids, st.integers(1, 3)), max_size=8))
    suffix = data.draw(st.sampled_from([".log", ".mcap"]))
    random = np.random.default_rng(data.draw(st.integers(0, 1 << 30)))
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        with create_recording(path, map_name="T") as recorder:
            time = 0.0
            for moved, rated, times in frames:
                for _ in range(times):
                    poses = [(id, *random.normal(0, 1e3, 6)) for id in moved]
                    speeds = [(id, *random.normal(0, 10, 6)) for id in rated]
                    recorder.add_frame(time, transforms=poses, velocities=speeds)
                    time += 0.25
        with open_recording(path) as recording:
            found = recording.trajectories()
            assert set(found) == {id for frame in recording for id in frame["transforms"]["id"].tolist()}
            for id, trajectory in found.items():
                check(recording, id, trajectory)
                for name, values in recording.trajectory(id).columns().items():
                    np.testing.assert_array_equal(values, getattr(trajectory, name))


def test_steps_of_a_trajectory_and_a_part_of_it() -> None:
    x = np.array([0.0, 1.0, np.nan, 3.0, 400.0, 401.0])
    columns = {name: np.zeros(6) for name in ("y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz")}
    path = Trajectory(1, np.arange(6) * 0.1, x, velocity_recorded=np.zeros(6, np.bool_), **columns)
    part = path.during(0.1, 0.45)
    assert part.time == pytest.approx([0.1, 0.3, 0.4])
    assert part.x.tolist() == [1, 3, 400]
    assert part.steps == pytest.approx([2, np.nan], nan_ok=True)
    assert path.during(0.3, 0.3).steps.tolist() == []
    assert len(path.during(9, 10)) == 0


def test_trajectories_of_a_kind(crossing: Recording) -> None:
    vehicles = crossing.trajectories("vehicle")
    assert set(vehicles) == {id for id in crossing.trajectories() if crossing.actors[id].kind == "vehicle"}
    with pytest.raises(RecapError, match=r"crossing\.\w+: no actors of kind 'tank'; there are .*vehicle"):
        crossing.trajectories("tank")


def test_trajectories_in_the_axes_of_carla(crossing: Recording) -> None:
    ours, theirs = crossing.trajectories(), crossing.trajectories(axes="carla")
    for id, path in ours.items():
        assert not any(np.signbit(values[values == 0]).any() for values in (path.y, path.vy, path.pitch, path.yaw))
        for name in path.columns():
            sign = -1 if name in ("y", "vy", "pitch", "yaw") else 1
            np.testing.assert_array_equal(getattr(theirs[id], name), sign * getattr(path, name))
    with pytest.raises(RecapError, match="axes must be one of"):
        crossing.trajectories(axes="ros")  # type: ignore[arg-type]


def test_trajectories_are_one_table(crossing: Recording) -> None:
    found = crossing.trajectories()
    columns = found.columns()
    assert list(columns)[:5] == ["id", "time", "x", "y", "z"]
    assert len(columns["id"]) == sum(map(len, found.values()))
    for id, path in found.items():
        for name, values in path.columns().items():
            np.testing.assert_array_equal(columns[name][columns["id"] == id], values)
    assert found.units()["speed"] == "m/s"
    assert set(found.units()) <= set(columns)
    sensor = next(actor.id for actor in crossing.actors.values() if actor.id not in found)
    for one in (crossing.trajectory(next(iter(found))), crossing.trajectory(sensor)):
        assert {name: values.dtype for name, values in one.columns().items()} == {n: v.dtype for n, v in columns.items()}
        assert one.units() == found.units()


@pytest.mark.parametrize("key", [0, slice(None, None, 2), slice(None, None, -1), ("transforms",)])
def test_a_batch_takes_names_and_slices_of_frames_in_a_row(key: object) -> None:
    with open_recording(CROSSING) as recording:
        batch = max(recording.batches(), key=len)
        assert len(batch[1:4]) == len(batch[1:4:1]) == 3
        with pytest.raises(TypeError, match="expected the name of a record type, or a slice of frames in a row, found"):
            batch[key]  # type: ignore[call-overload]


def test_rows_that_are_later_than_all_before() -> None:
    time = np.array([0.0, 0.5, 0.2, 0.5, np.nan, 0.7])
    every = dict.fromkeys(("time", "x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz"), time)
    found = Trajectory(1, **every, velocity_recorded=np.zeros(6, np.bool_)).ascending()
    assert found.time.tolist() == [0.0, 0.5, 0.7]
