"""How the messages of chunks become batches."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap import create_recording, open_recording

if TYPE_CHECKING:
    from pathlib import Path


def test_frames_of_one_form_are_one_batch_each_time_the_form_changes(tmp_path: Path) -> None:
    with create_recording(tmp_path / "run.mcap", map_name="", date=0) as recorder:
        for number in range(150):
            poses = [{"id": id, "x": 100.0 * number} for id in range(10 + number // 50)]
            recorder.add_frame(number / 10, transforms=poses)
    with open_recording(tmp_path / "run.mcap") as recording:
        batches = list(recording.reader.batches(("transforms",)))
    assert [len(batch) for batch in batches] == [50, 50, 50]
    assert [batch.records("transforms").shape for batch in batches] == [(50, 10), (50, 11), (50, 12)]
    assert [batch.records("transforms")["x"][-1, 0].item() for batch in batches] == [4900, 9900, 14900]
