"""Pointers of Git LFS in place of the files that are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from carla_recap import RecapError, SensorRig, import_tracks, load_rules, open_recording
from carla_recap.metrics.running import _criteria
from carla_recap.queries.score.route_files import read_routes
from carla_recap.roads import load_map

POINTER = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 12345\n"


@pytest.mark.parametrize(
    ("name", "opened"),
    [
        ("run.mcap", open_recording),
        ("run.log", open_recording),
        ("Town.xodr", load_map),
        ("routes.xml", read_routes),
        ("tracks.csv", lambda path: import_tracks(path, path.with_name("out.mcap"))),
        ("rig.json", SensorRig.load),
        ("rules.toml", load_rules),
        ("criteria.json", _criteria),
    ],
)
def test_a_pointer_of_git_lfs_is_named(tmp_path: Path, name: str, opened: Callable[[Path], Any]) -> None:
    (tmp_path / name).write_text(POINTER)
    with pytest.raises(RecapError, match=f"{name}: is a pointer of Git LFS, not the file itself"):
        opened(tmp_path / name)
