"""How the messages of chunks become batches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap import convert, create_recording, open_recording
from tests.samples import END, listed, log_header, packet, save, spawn, start, transform

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


@pytest.mark.parametrize("times", [[1.0] * 10, [10.0, 10.05, 10.1, *range(7)], [1 + 2e-8 * number for number in range(10)]])
def test_frames_keep_their_order_whatever_the_clock_says(tmp_path: Path, times: list[float]) -> None:
    frames = [[start(number, time), packet(6, listed(transform(1)))] for number, time in enumerate(times)]
    frames[4][1] = packet(6, listed(transform(1), transform(2)))
    frames[5].insert(1, packet(2, listed(spawn(9, 1, "vehicle.tesla.model3"))))
    save(tmp_path / "run.log", b"".join([log_header(), *(part for frame in frames for part in (*frame, END))]))
    convert(tmp_path / "run.log", tmp_path / "run.mcap")
    convert(tmp_path / "run.mcap", tmp_path / "back.log")
    assert (tmp_path / "back.log").read_bytes() == (tmp_path / "run.log").read_bytes()
