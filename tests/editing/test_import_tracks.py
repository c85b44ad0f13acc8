"""Recordings of CSV files: names, units, axes, and the way back."""

from __future__ import annotations

import csv
import math
import os
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from warnings import catch_warnings

import numpy as np
import pytest

from carla_recap import RecapError, RecapWarning, create_recording, export_csv, import_tracks, open_recording
from carla_recap.model.blueprints import blueprint_sizes
from carla_recap.model.records import ActorKind, Spawn
from tests.samples import CARLA_LOGS, SAMPLES


@pytest.fixture
def table(tmp_path):
    def write(text, **options):
        source = tmp_path / "tracks.csv"
        source.write_text(text, "utf-8")
        import_tracks(source, tmp_path / "out.mcap", map_name="Town01", force=True, **options)
        return open_recording(tmp_path / "out.mcap")

    return write


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.reader(file))


def test_a_table_becomes_a_recording(table):
    with table("time,id,x,y,z,yaw\n0,7,1,2,3,90\n0.5,7,2,2,3,90\n0.5,8,0,0,0,0\n1.0,8,1,0,0,0\n", hero="8") as recording:
        assert recording.info.map_name == "Town01"
        assert [frame.elapsed for frame in recording] == [0, 0.5, 1]
        path = recording.trajectory(7)
        assert np.allclose((path.x, path.y, path.z, path.yaw), ([1, 2], [2, 2], [3, 3], [90, 90]))
        car, other = recording.actors.values()
        assert (car.kind, car.spawned_at, car.destroyed_at) == ("vehicle", 0, 1)
        assert (other.spawned_at, other.destroyed_at, other.is_hero) == (0.5, None, True)


@pytest.mark.parametrize(("until", "lives"), [(2.2, [(1.2, 2.7)]), (2.7, [(1.2, 1.7), (2.7, None)])])
def test_an_object_that_is_missing_for_long_disappears(table, until, lives):
    others = "".join(f"{time},8,0,0,,,\n" for time in (1.2, 1.7, 2.2, 2.7))
    with table(f"time,id,x,y,length,width,role_name\n1.2,7,1,2,4,2,hero\n{until},7,2,2,4,2,\n" + others) as recording:
        found = [(life.spawned_at, life.destroyed_at) for life in recording.actors.lives if life.is_hero]
    assert found == lives


def test_numbers_are_stored_in_carlas_units_and_axes(table):
    with table("time,id,x,y,yaw,vx,vy\n0,7,1,2,90,3,4\n") as recording:
        (frame,) = recording
        assert frame["transforms"].tolist() == [(7, 100, -200, 0, 0, 0, -90)]
        assert frame["velocities"].tolist() == [(7, 3, -4, 0, 0, 0, 0)]


def test_a_velocity_without_its_part_upward_is_recorded(table):
    with table("time,id,x,y,yaw,vx,vy,vz\n0,7,1,2,90,3,4,\n1,7,1,2,90,3,4,5\n") as recording:
        velocities = [frame["velocities"].tolist() for frame in recording]
    assert velocities == [[(7, 3, -4, 0, 0, 0, 0)], [(7, 3, -4, 5, 0, 0, 0)]]


def test_a_yaw_rate_reaches_across_no_gap_and_no_jump(table):
    rows = [(0, 0, 0), (0.1, 1, 5), (2, 20, 90), (2.1, 21, 95), (2.2, 900, 180)]
    with table("time,id,x,y,yaw,vx,vy\n" + "".join(f"{t},7,{x},0,{yaw},10,0\n" for t, x, yaw in rows)) as recording:
        rates = [frame["velocities"]["angular_z"][0] for frame in recording]
    assert rates == pytest.approx([-50, -50, -50, -50, 0])


def test_a_negative_zero_is_zero(table):
    with table("time,id,x,y\n-0,7,-0,1\n") as recording:
        (frame,) = recording
        assert (str(frame.elapsed), str(frame["transforms"]["x"][0])) == ("0.0", "0.0")


def test_units_and_axes_are_options(table):
    options = {"time_unit": "ms", "length_unit": "cm", "angle_unit": "rad", "axes": "carla"}
    with table(f"time,id,x,y,yaw,vx,vy\n1500,7,1,2,{math.pi / 2},300,400\n", **options) as recording:
        (frame,) = recording
        assert frame.elapsed == 1.5
        assert frame["transforms"].tolist() == [(7, 1, 2, 0, 0, 0, 90)]
        assert frame["velocities"].tolist() == [(7, 3, 4, 0, 0, 0, 0)]


@pytest.mark.parametrize(
    ("names", "ids"),
    [
        (["7", "4294967294"], [7, 4294967294]),
        (["7", "4294967295"], [1, 2]),  # no actor, in recordings
        (["7", "42949672940"], [1, 2]),
        (["0", "7"], [1, 2]),
        (["07", "7"], [1, 2]),
        (["7", "car"], [1, 2]),
    ],
)
def test_names_that_are_ids_stay_so(table, names, ids):
    with table("time,id,x,y\n" + "".join(f"0,{name},{n},0\n" for n, name in enumerate(names))) as recording:
        (frame,) = recording
        assert sorted(frame["transforms"]["id"].tolist()) == ids


def test_columns_may_have_other_names(table):
    with table(
        "Frame Time,track,east,north\n0,7,1,2\n", columns={"time": "Frame Time", "id": "track", "x": "east", "y": "north"}
    ) as recording:
        assert recording.trajectory(7).x == [1]


@pytest.mark.parametrize("separator", [";", "\t"])
def test_semicolons_and_tabs_separate_columns_too(table, separator):
    with table("time,id,x,y\n0,7,1,2\n".replace(",", separator)) as recording:
        assert recording.trajectory(7).y == [2]


def test_nanoseconds_are_known_by_the_name_of_their_column(table):
    with table("total_nanos,idx,x,y\n0,7,0,0\n2000000000,7,1,0\n") as recording:
        assert recording.info.duration == 2


@pytest.mark.parametrize(("unit", "digits"), [("s", 0), ("ms", 3), ("us", 6)])
def test_times_since_1970_are_shifted_in_their_own_unit(table, unit, digits):
    rows = "".join(f"{1_700_000_000 * 10**digits + step},7,{step},0\n" for step in range(4))
    with table(f"time,id,x,y\n{rows}", time_unit=unit) as recording:
        assert [frame.elapsed for frame in recording] == [step / 10**digits for step in range(4)]
        assert recording.header.date == 1_700_000_000


def test_without_a_yaw_objects_face_their_motion_and_keep_it_at_a_standstill(table):
    rows = [(0, 0, 0), (1, 0, 0), (2, 0, 5), (3, 0, 5), (4, -5, 5), (5, -5, 5)]
    text = "time,id,x,y\n" + "".join(f"{time},7,{x},{y}\n" for time, x, y in rows)
    with table(text) as recording:
        assert np.allclose(recording.trajectory(7).yaw % 360, [90, 90, 90, 180, 180, 180]), recording.trajectory(7).yaw


def test_kinds_choose_blueprints_and_sizes_become_boxes(table):
    with table(
        "time,id,x,y,class,length,width,height\n0,a,0,0,pedestrian,0.5,0.6,1.8\n0,b,5,0,Truck,8,2.5,3\n"
    ) as recording:
        walker, truck = recording.actors.values()
        assert (walker.kind, truck.type_id) == ("walker", "vehicle.carlamotors.european_hgv")
        assert (truck.bounding_box.extent_x, truck.bounding_box.z) == (4, 1.5)
        assert [actor.attributes["track_id"] for actor in (walker, truck)] == ["a", "b"]


@pytest.mark.parametrize("sample", ["crossing.log", "crash.mcap"])
def test_an_export_imported_again_has_the_same_transforms(tmp_path, sample):
    with open_recording(SAMPLES / sample) as recording:
        export_csv(recording, tmp_path / "tracks.csv")
        ids = {id for id, actor in recording.actors.items() if actor.kind in ("vehicle", "walker")}
        expected = [[row for row in frame["transforms"].tolist() if row[0] in ids] for frame in recording]
    import_tracks(tmp_path / "tracks.csv", tmp_path / "again.log")
    with open_recording(tmp_path / "again.log") as again:
        assert [sorted(frame["transforms"].tolist()) for frame in again] == [sorted(rows) for rows in expected]
        export_csv(again, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "tracks.csv").read_bytes()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("time,id,x\n", "no column y"),
        ("time,id,x,y\n0,7,1\n", "line 2: expected 4 values, found 3"),
        ("time,id,x,y\n0,7,1,north\n", "line 2: y: expected a number, found 'north'"),
        ("time,id,x,y\n0,7,1,nan\n,7,1,1\n", "no rows with a time and a position"),
        ("time,id,x,y\n0,7,1,1\n0,7,2,2\n", "lines 2 and 3: object 7 has two rows at 0 s"),
        ("time,id,x,y\n0,7,1e38,1\n", "line 2: x is 1e38, which is too large"),
        ("time,id,x,y\n-1e308,7,1,1\n1e308,7,1,1\n", "more seconds between the first and the last time"),
        ("time,id,x,y\n0,,1,1\n", "line 2: the id is empty"),
        (f"time,id,x,y\n0,{'7' * 1_001},1,1\n", "line 2: id: expected at most 1000 characters, found 1001"),
        (f"time,id,x,y\n0,{'7' * 70_000},1,1\n", "line 2: expected a line of less than 65536 bytes"),
        ("time,id,x,y\n" + '0,"7\n' + 40_000 * '","\n', "line 2: is no row of a CSV file"),
        ("time,id,x,y\n" + "".join(f"0,{id},1,1\n" for id in range(65_536)), "65536 objects at 0 s; a recording has at"),
        ("time,id,x,y,X\n0,7,1,1,2\n", "two columns are named x"),
        ('time,id,x,y\n0,"7,1,1\n1,"7,2,2\n', "line 2: is no row of a CSV file"),
        ('time,id,x,y\n0,7,1,1\n1,"7,2,2\n2,7,1,1\n', "line 3: is no row of a CSV file .unexpected end of data"),
    ],
)
def test_what_is_no_such_table_is_an_error_and_leaves_no_file(tmp_path, text, message):
    source = tmp_path / "tracks.csv"
    source.write_text(text, "utf-8")
    with pytest.raises(RecapError, match=message), catch_warnings(action="ignore", category=RecapWarning):
        import_tracks(source, tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["tracks.csv"]


@pytest.mark.parametrize("kind", ["directory", "fifo", "device"])
def test_only_regular_files_are_read(tmp_path, kind):
    source = tmp_path / "tracks.csv"
    if kind == "directory":
        source.mkdir()
    elif kind == "fifo":
        os.mkfifo(source)
    else:
        source = Path("/dev/zero")
    with pytest.raises(RecapError, match=f"{source}: is no regular file"):
        import_tracks(source, tmp_path / "out.mcap")


def test_rows_without_a_time_or_a_position_are_left_out(table):
    with pytest.warns(RecapWarning, match="2 rows without a time or a position left out, the first in line 3"):
        recording = table("time,id,x,y\n0,7,1,2\n1,7,,2\n2,7,3,4\n,7,5,6\n")
    with recording:
        assert recording.trajectory(7).time.tolist() == [0, 2]
        assert recording.trajectory(7).x.tolist() == [1, 3]


def test_the_date_is_given_or_that_of_unix_times(table):
    rows = "time,id,x,y\n{0},7,1,2\n{1},7,2,2\n"
    given = datetime(2024, 5, 1, 12, 30, tzinfo=UTC)
    for first, date, expected in ((0, None, 0), (1_700_000_000, None, 1_700_000_000), (1_700_000_000, given, 1_714_566_600)):
        with table(rows.format(first, first + 1), date=date) as recording:
            assert (recording.header.date, recording.info.duration) == (expected, 1)


@pytest.mark.parametrize(
    "path", [*sorted((CARLA_LOGS.parent).rglob("*.log")), *SAMPLES.glob("*.mcap")], ids=lambda path: path.name
)
def test_every_export_is_imported_again(tmp_path, path):
    tracks, again = tmp_path / "tracks.csv", tmp_path / "again.csv"
    with catch_warnings(action="ignore", category=RecapWarning):
        try:
            with open_recording(path) as recording:
                export_csv(recording, tracks)
        except RecapError as error:
            pytest.skip(f"nothing to export: {error}")
        if tracks.read_text().count("\n") == 1:
            pytest.skip("it has neither vehicles nor walkers")
        import_tracks(tracks, tmp_path / "again.log", date=datetime(2024, 5, 1, tzinfo=UTC))
        with open_recording(tmp_path / "again.log") as recording:
            export_csv(recording, again)
    # Unnamed blueprints get a name, and where an id has a gap, as between two actors, its object stands.
    first, second = (Counter((*row[:1], *row[2:3], *row[5:]) for row in rows_of(file)) for file in (tracks, again))
    assert not first - second
    assert {row[1:8] for row in second - first} <= {row[1:8] for row in first}


def test_what_is_not_finite_is_empty_in_a_table_and_said(tmp_path):
    with create_recording(tmp_path / "run.log", map_name="Town01", additional_data=True) as recorder:
        spawns = [Spawn(7, ActorKind.VEHICLE, type_id="vehicle.audi.tt")]
        recorder.add_frame(
            0.0, spawned=spawns, transforms=[(7, 3e38, 0, 0, 0, 0, 0)], velocities=[(7, math.nan, math.inf, 1, 0, 0, 0)]
        )
        recorder.add_frame(1.0, transforms=[(7, math.nan, 0, 0, 0, 0, 0)])
    with open_recording(tmp_path / "run.log") as recording, pytest.warns(RecapWarning, match="1 of 2 poses are not finite"):
        export_csv(recording, tmp_path / "tracks.csv")
    _, row = rows_of(tmp_path / "tracks.csv")
    assert row[11:14] == ["", "", ""]
    import_tracks(tmp_path / "tracks.csv", tmp_path / "again.log")
    with open_recording(tmp_path / "again.log") as again:
        (frame,) = again
        assert frame["transforms"]["x"] == np.float32(3e38)


def test_what_is_not_finite_is_unknown(table):
    with table("time,id,x,y,z,yaw,length,width,vx,vy\n0,7,1,2,inf,-inf,inf,2,inf,nan\n") as recording:
        (frame,) = recording
        assert frame["transforms"].tolist() == [(7, 100, -200, 0, 0, 0, 0)]
        assert len(frame["velocities"]) == len(frame["bounding_boxes"]) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": {"east": "x"}}, "no column 'east'"),
        ({"columns": {"x": "east"}}, "no column east for x"),
        ({"hero": "9"}, "no object 9; ids are "),
        ({"length_unit": "yd"}, "length_unit must be one of m, cm"),
    ],
)
def test_wrong_options_are_errors(table, options, message):
    with pytest.raises(RecapError, match=message):
        table("time,id,x,y\n0,7,1,2\n", **options)


@pytest.mark.parametrize("rows", [0, 5_000])
def test_of_bytes_that_are_no_text_the_first_is_said(tmp_path, rows):
    source = tmp_path / "tracks.csv"
    source.write_bytes(b"time,id,x,y\n" + b"0,\xc3\xa4,1,1\n" * rows + b"0,\xff,1,1\n")
    with pytest.raises(RecapError, match=f"line {rows + 2}: .* no UTF-8"):
        import_tracks(source, tmp_path / "out.log")


def test_empty_lines_are_read_up_to_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("carla_recap.editing.import_tracks._LINES", 1_000)
    source = tmp_path / "tracks.csv"
    source.write_text("time,id,x,y\n" + "\n" * 1_001)
    with pytest.raises(RecapError, match="line 1001: at most 1,000 lines are read"):
        import_tracks(source, tmp_path / "out.log")


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_a_map_name_that_no_header_holds_is_an_error(tmp_path, suffix):
    source = tmp_path / "tracks.csv"
    source.write_text("time,id,x,y\n0,7,1,1\n")
    with pytest.raises(RecapError, match=r"expected a map name of at most 65535 bytes, found 100000: x+…"):
        import_tracks(source, tmp_path / f"out{suffix}", map_name="x" * 100_000)
    assert [path.name for path in tmp_path.iterdir()] == ["tracks.csv"]


def test_vehicles_look_like_those_of_their_size_and_differ(table):
    rows = [(number, 1.8 if number > 5 else 4.5, 0.7 if number > 5 else 1.8) for number in range(10)]
    text = "time,id,x,y,length,width\n" + "".join(f"0,{id},{9 * id},0,{length},{width}\n" for id, length, width in rows)
    with table(text) as recording:
        names = [actor.type_id for actor in recording.actors.values()]
    sizes = blueprint_sizes()
    assert all(abs(sizes[name][0] - 4.5) < 0.6 for name in names[:6])
    assert all(sizes[name][1] < 1 for name in names[6:])
    assert len(set(names)) >= 6


@pytest.mark.parametrize("kind", ["vehicle", "walker"])
def test_cars_without_a_size_and_walkers_look_different(table, kind):
    text = "time,id,x,y,kind\n" + "".join(f"0,{id},{9 * id},0,{kind}\n" for id in range(12))
    with table(text) as recording:
        assert len({actor.type_id for actor in recording.actors.values()}) == 12
        assert {actor.kind for actor in recording.actors.values()} == {kind}
