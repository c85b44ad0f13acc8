from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pytest

from carla_recap.editing.import_tracks import import_tracks
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.recording import open_recording

if TYPE_CHECKING:
    from pathlib import Path

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


def table(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    return path


def test_ind_has_centers_headings_and_frames_in_any_order(tmp_path: Path) -> None:
    import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap", rate=25)
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
        import_tracks(table(tmp_path, NGSIM), path, length_unit="ft", position="front", **options)  # type: ignore[arg-type]
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
    import_tracks(table(tmp_path, HIGHD), tmp_path / "highd.log", rate=25, position="corner", axes=axes)
    with open_recording(tmp_path / "highd.log") as recording:
        drive, other = recording.trajectory(1), recording.trajectory(2)
        assert drive.x == pytest.approx([362.26 + 2.425, 363.89 + 2.425], abs=1e-4)
        assert drive.y == pytest.approx([side * (21.68 + 1.06)] * 2, abs=1e-4)
        assert (other.x[0], other.y[0]) == pytest.approx((106.25, side * 10.25), abs=1e-4)
        assert (drive.time[0], drive.yaw[0], abs(other.yaw[0])) == pytest.approx((0.04, 0, 180))
        assert abs(recording.trajectory(3).yaw) == pytest.approx([180])  # a single row: that of its velocity
        box = recording.actors[2].bounding_box
        assert (box.extent_x, box.extent_y, box.z) == pytest.approx((6.25, 1.25, 0.75))


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("time,id,x,y\n0,1,1,1\n", {"rate": 25}, "no column frame or frame_id for time"),
        (HIGHD, {"rate": 25, "time_unit": "ms"}, "time_unit: expected none"),
        (HIGHD, {"rate": 25, "position": "middle"}, "position must be one of center, corner, front"),
        (IND, {"rate": 25, "position": "corner"}, None),
        ("frame,id,x,y\n0,1,1,1\n", {"rate": 25, "position": "front"}, "no column length for positions"),
        ("frame,id,x,y,length\n0,1,1,1,4\n1,1,2,1,\n", {"rate": 25, "position": "front"}, "line 3: expected the length"),
        ("frame,id,x,y\n0,1,1,1\n2,2,1,1\n2, 1,2,1\n2,1,2,1\n", {"rate": 25}, "lines 4 and 5: object 1 has two rows"),
        ("\nframe,id,x,y\n0,1,1,1\n", {"rate": 25}, "no column frame or frame_id for time"),
    ],
)
def test_what_gives_no_middle_or_no_time_is_an_error(
    tmp_path: Path, text: str, options: dict[str, Any], message: str | None
) -> None:
    with pytest.raises(RecapError, match=message or "no column width and height for positions"):
        import_tracks(table(tmp_path, text), tmp_path / "out.mcap", **options)


def test_frames_of_many_hours_are_no_dates(tmp_path: Path) -> None:
    import_tracks(table(tmp_path, "frame,id,x,y\n9000000,1,1,1\n9000050,1,2,1\n"), tmp_path / "out.mcap", rate=25)
    with open_recording(tmp_path / "out.mcap") as recording:
        assert (recording.info.date.timestamp(), recording.info.duration) == (0, 2)


def test_frames_without_a_rate_are_named(tmp_path: Path) -> None:
    with pytest.raises(RecapError, match="with a rate, its frames are times"):
        import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap")
    with pytest.warns(RecapWarning, match="frames are taken as times"):
        import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap", columns={"time": "frame"})


@pytest.mark.parametrize("rate", [0.0, -25.0, float("nan"), float("inf")])
def test_a_rate_is_above_0(tmp_path: Path, rate: float) -> None:
    with pytest.raises(RecapError, match="rate: expected"):
        import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap", rate=rate)
