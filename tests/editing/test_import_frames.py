from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap.editing.import_tracks import import_tracks
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.recording import open_recording

if TYPE_CHECKING:
    from pathlib import Path

HIGHD = "frame,id,x,y,width,height,xVelocity,yVelocity\n1,1,362.26,21.68,4.8,2.2,40.85,0\n2,1,363.89,21.68,4.8,2.2,40.87,0\n"
IND = "recordingId,trackId,frame,xCenter,yCenter,heading\n0,0,26,129.05,-31.32,173.82\n0,0,27,128.6,-31.3,173.9\n"
NGSIM = "Vehicle_ID,Frame_ID,Local_X,Local_Y,v_length,v_Width\n2224,6548,41.0,472.0,15,6\n2224,6549,41.0,475.0,15,6\n"


def table(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    return path


def test_frames_are_times_by_their_rate(tmp_path: Path) -> None:
    import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap", rate=25)
    with open_recording(tmp_path / "ind.mcap") as recording:
        (id,) = recording.actors
        assert np.diff(recording.trajectory(id).time) == pytest.approx([0.04])


def test_feet_are_0_3048_metres(tmp_path: Path) -> None:
    import_tracks(table(tmp_path, NGSIM), tmp_path / "ngsim.mcap", rate=10, length_unit="ft")
    with open_recording(tmp_path / "ngsim.mcap") as recording:
        drive = recording.trajectory(2224)
        assert (drive.x[0], drive.y[0]) == pytest.approx((41 * 0.3048, 472 * 0.3048))
        assert np.diff(drive.time) == pytest.approx([0.1])


@pytest.mark.parametrize(("axes", "side"), [("carla", -1), ("right-handed", 1)])
def test_a_corner_of_a_box_becomes_its_middle(tmp_path: Path, axes: str, side: int) -> None:
    import_tracks(table(tmp_path, HIGHD), tmp_path / "highd.log", rate=25, corners=True, axes=axes)  # type: ignore[arg-type]
    with open_recording(tmp_path / "highd.log") as recording:
        drive = recording.trajectory(1)
        assert (drive.x[0], drive.y[0]) == pytest.approx((362.26 + 2.4, side * (21.68 + 1.1)), abs=1e-3)


def test_frames_without_a_rate_are_named(tmp_path: Path) -> None:
    with pytest.raises(RecapError, match="with a rate, its frames are times"):
        import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap")
    with pytest.warns(RecapWarning, match="frames are taken as times"):
        import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap", columns={"time": "frame"})


@pytest.mark.parametrize("rate", [0.0, -25.0, float("nan"), float("inf")])
def test_a_rate_is_above_0(tmp_path: Path, rate: float) -> None:
    with pytest.raises(RecapError, match="rate: expected"):
        import_tracks(table(tmp_path, IND), tmp_path / "ind.mcap", rate=rate)
