"""Recordings of CSV files: names, units, axes, and the way back."""

from __future__ import annotations

import csv
import math
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal
from warnings import catch_warnings

import numpy as np
import pytest

from carla_recap import RecapError, RecapWarning, export_csv, import_tracks, open_recording
from carla_recap.model.blueprints import blueprint_sizes
from tests.samples import SAMPLES, names_in

HIGHD = """frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,laneId
1,1,362.26,21.68,4.85,2.12,40.85,0.00,0.30,0.00,5
2,1,363.89,21.68,4.85,2.12,40.87,0.00,0.30,0.00,5
1,2,100.00,9.00,12.5,2.5,-25.0,0.00,0.0,0.00,2
2,2,99.00,9.00,12.5,2.5,-25.0,0.00,0.0,0.00,2
2,3,50.00,9.00,4.0,2.0,-25.0,0.00,0.0,0.00,2
"""
IND = """recordingId,trackId,frame,trackLifetime,xCenter,yCenter,heading,width,length,xVelocity,yVelocity,lonVelocity
0,0,28,2,128.12,-31.22,3,2.02,4.55,-11.57,1.24,11.6
0,0,26,0,129.05,-31.32,359,2.02,4.55,-11.57,1.24,11.6
0,0,27,1,128.59,-31.27,1,2.02,4.55,-11.57,1.24,11.6
"""
NGSIM = """Vehicle_ID,Frame_ID,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_length,v_Width,v_Class,v_Vel
2224,6548,1113437421700,41.0,472.0,6042814.264,2133542.012,15.0,6.0,2,26.54
2224,6549,1113437421800,41.0,475.0,6042814.264,2133544.666,15.0,6.0,2,26.54
2225,6549,1113437421800,60.0,400.0,6042814.264,2133544.666,50.0,8.0,3,26.54
"""


def tracks(tmp_path, text):
    path = tmp_path / "tracks.csv"
    path.write_text(text, "utf-8")
    return path


@pytest.fixture
def table(tmp_path):
    def write(text, **options):
        import_tracks(tracks(tmp_path, text), tmp_path / "out.mcap", map_name="Town01", force=True, **options)
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
    with table("time,id,x,y,yaw,vx,vy,vz\n0,7,1,2,90,3,4,\n1,7,1,2,90,3,4,5\n") as recording:
        for frame, upward in zip(recording, (0, 5), strict=True):
            assert frame["transforms"].tolist() == [(7, 100, -200, 0, 0, 0, -90)]
            assert frame["velocities"].tolist() == [(7, 3, -4, upward, 0, 0, 0)]


def test_a_yaw_rate_reaches_across_no_gap_and_no_jump(table):
    rows = [(0, 0, 0), (0.1, 1, 5), (2, 20, 90), (2.1, 21, 95), (2.2, 900, 180)]
    with table("time,id,x,y,yaw,vx,vy\n" + "".join(f"{t},7,{x},0,{yaw},10,0\n" for t, x, yaw in rows)) as recording:
        rates = [frame["velocities"]["angular_z"][0] for frame in recording]
    assert rates == pytest.approx([-50, -50, -50, -50, 0])


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


ROW = "time,id,x,y\n0,7,1,1\n"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", {}, "is empty"),
        ("time,id,x\n", {}, "no column y"),
        ("time,id,x,y\n0,7,1\n", {}, "line 2: expected 4 values, found 3"),
        ("time,id,x,y\n0,7,1,north\n", {}, "line 2: y: expected a number, found 'north'"),
        ("time,id,x,y\n0,7,1,nan\n,7,1,1\n", {}, "no rows with a time and a position"),
        (ROW + "0,7,2,2\n", {}, "lines 2 and 3: object 7 has two rows at 0 s"),
        ("time,id,x,y\n0,7,1e38,1\n", {}, "line 2: x is 1e38, which is too large"),
        ("time,id,x,y\n-1e308,7,1,1\n1e308,7,1,1\n", {}, "more seconds between the first and the last time"),
        ("time,id,x,y\n0,,1,1\n", {}, "line 2: the id is empty"),
        (f"time,id,x,y\n0,{'7' * 1_001},1,1\n", {}, "line 2: id: expected at most 1000 characters, found 1001"),
        (f"time,id,x,y\n0,{'7' * 70_000},1,1\n", {}, "line 2: expected a line of less than 65536 bytes"),
        ("time,id,x,y\n" + '0,"7\n' + 40_000 * '","\n', {}, "line 2: is no row of a CSV file"),
        ("time,id,x,y\n" + "".join(f"0,{id},1,1\n" for id in range(65_536)), {}, "65536 objects at 0 s; a recording has at"),
        ("time,id,x,y,X\n0,7,1,1,2\n", {}, "two columns are named x"),
        ('time,id,x,y\n0,"7,1,1\n1,"7,2,2\n', {}, "line 2: is no row of a CSV file"),
        (ROW + '1,"7,2,2\n2,7,1,1\n', {}, "line 3: is no row of a CSV file .unexpected end of data"),
        ("time,id,x,y\n0,\udcff,1,1\n", {}, "line 2: .* no UTF-8"),
        ("time,id,x,y\n" + "0,ä,1,1\n" * 5_000 + "0,\udcff,1,1\n", {}, "line 5002: .* no UTF-8"),
        (ROW, {"columns": {"east": "x"}}, "no column 'east'"),
        (ROW, {"columns": {"x": "east"}}, "no column east for x"),
        (ROW, {"hero": "9"}, "no object 9; ids are "),
        (ROW, {"length_unit": "yd"}, "length_unit must be one of m, cm"),
        (ROW, {"map_name": "x" * 100_000}, r"expected a map name of at most 65535 bytes, found 100000: x+…"),
        (ROW, {"rate": 25}, "no column frame or frame_id for time"),
        (IND, {}, "with a rate, its frames are times"),
        *((IND, {"rate": rate}, "rate: expected") for rate in (0.0, -25.0, math.nan, math.inf)),
        (HIGHD, {"rate": 25, "time_unit": "ms"}, "time_unit: expected none"),
        (HIGHD, {"rate": 25, "position": "middle"}, "position must be one of center, corner, front"),
        (IND, {"rate": 25, "position": "corner"}, "no column width and height for positions"),
        ("frame,id,x,y\n0,1,1,1\n", {"rate": 25, "position": "front"}, "no column length for positions"),
        ("frame,id,x,y,length\n0,1,1,1,4\n1,1,2,1,\n", {"rate": 25, "position": "front"}, "line 3: expected the length"),
        ("frame,id,x,y\n0,1,1,1\n2,2,1,1\n2, 1,2,1\n2,1,2,1\n", {"rate": 25}, "lines 4 and 5: object 1 has two rows"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_what_is_no_such_table_is_an_error_and_leaves_no_file(tmp_path, text, options, message):
    source = tmp_path / "tracks.csv"
    source.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(RecapError, match=message), catch_warnings(action="ignore", category=RecapWarning):
        import_tracks(source, tmp_path / "out.mcap", **options)
    assert names_in(tmp_path) == ["tracks.csv"]


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


def test_what_is_not_finite_is_unknown(table):
    with table("time,id,x,y,z,yaw,length,width,vx,vy\n0,7,1,2,inf,-inf,inf,2,inf,nan\n") as recording:
        (frame,) = recording
        assert frame["transforms"].tolist() == [(7, 100, -200, 0, 0, 0, 0)]
        assert len(frame["velocities"]) == len(frame["bounding_boxes"]) == 0


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


# --- frames instead of times, and positions that are no centers -----------------------------------------------


def test_ind_has_centers_headings_and_frames_in_any_order(tmp_path: Path) -> None:
    import_tracks(tracks(tmp_path, IND), tmp_path / "ind.mcap", rate=25)
    with open_recording(tmp_path / "ind.mcap") as recording:
        (actor,) = recording.actors.values()
        drive = recording.trajectory(actor.id)
        assert drive.time == pytest.approx([1.04, 1.08, 1.12])
        assert drive.x == pytest.approx([129.05, 128.59, 128.12], abs=1e-4)
        assert drive.y == pytest.approx([-31.32, -31.27, -31.22], abs=1e-4)
        assert drive.yaw % 360 == pytest.approx([359, 1, 3], abs=1e-4)
        assert (drive.vx[0], drive.vy[0]) == pytest.approx((-11.57, 1.24))
        turns = [frame["velocities"]["angular_z"].item() for frame in recording]
        assert turns == pytest.approx([-2 / 0.04, -4 / 0.08, -2 / 0.04])  # to the left, in CARLA's axes
        assert (actor.attributes["track_id"], actor.bounding_box.extent_x) == ("0", pytest.approx(2.275))


def test_ngsim_is_in_feet_from_the_middle_of_the_front(tmp_path: Path) -> None:
    foot = 0.3048
    for name, options in {"frames": {"rate": 10}, "ms": {"columns": {"time": "Global_Time"}, "time_unit": "ms"}}.items():
        path = tmp_path / f"{name}.mcap"
        import_tracks(tracks(tmp_path, NGSIM), path, length_unit="ft", position="front", **options)  # type: ignore[arg-type]
        with open_recording(path) as recording:
            drive = recording.trajectory(2224)
            assert drive.x == pytest.approx([41 * foot, 41 * foot], abs=1e-4)
            assert drive.y == pytest.approx([(472 - 7.5) * foot, (475 - 7.5) * foot], abs=1e-4)
            assert drive.yaw == pytest.approx([90, 90])
            assert np.diff(drive.time) == pytest.approx([0.1])
            car, truck = recording.actors[2224], recording.actors[2225]
            assert (car.bounding_box.extent_x, car.bounding_box.extent_y) == pytest.approx((7.5 * foot, 3 * foot))
            assert (truck.kind, truck.type_id) == ("vehicle", "vehicle.carlamotors.european_hgv")


@pytest.mark.parametrize(("axes", "side"), [("carla", -1), ("right-handed", 1)])
def test_a_corner_of_a_box_becomes_its_middle(tmp_path: Path, axes: Literal["carla", "right-handed"], side: int) -> None:
    import_tracks(tracks(tmp_path, HIGHD), tmp_path / "highd.log", rate=25, position="corner", axes=axes)
    with open_recording(tmp_path / "highd.log") as recording:
        drive, other = recording.trajectory(1), recording.trajectory(2)
        assert drive.x == pytest.approx([362.26 + 2.425, 363.89 + 2.425], abs=1e-4)
        assert drive.y == pytest.approx([side * (21.68 + 1.06)] * 2, abs=1e-4)
        assert (other.x[0], other.y[0]) == pytest.approx((106.25, side * 10.25), abs=1e-4)
        assert (drive.time[0], drive.yaw[0], abs(other.yaw[0])) == pytest.approx((0.04, 0, 180))
        assert abs(recording.trajectory(3).yaw) == pytest.approx([180])  # a single row: that of its velocity
        box = recording.actors[2].bounding_box
        assert (box.extent_x, box.extent_y, box.z) == pytest.approx((6.25, 1.25, 0.75))


def test_frames_of_many_hours_are_no_dates(tmp_path: Path) -> None:
    import_tracks(tracks(tmp_path, "frame,id,x,y\n9000000,1,1,1\n9000050,1,2,1\n"), tmp_path / "out.mcap", rate=25)
    with open_recording(tmp_path / "out.mcap") as recording:
        assert (recording.info.date.timestamp(), recording.info.duration) == (0, 2)


def test_frames_without_a_rate_can_be_times(tmp_path: Path) -> None:
    with pytest.warns(RecapWarning, match="frames are taken as times"):
        import_tracks(tracks(tmp_path, IND), tmp_path / "ind.mcap", columns={"time": "frame"})
