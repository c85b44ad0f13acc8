"""Pages, and what is in them."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.queries.incidents import IncidentOptions
from carla_recap.queries.kinds import kinds_without_roads
from carla_recap.replay import Player
from carla_recap.show.page import write_report
from carla_recap.show.page.samples import SampledReplay, Sampler
from tests.replay.scripts import write
from tests.samples import CROSSING

NASTY = "</script><img src=x onerror=\"document.title='broken'\">\u2028\u2029\x01\"'&amp;"
"""Text that breaks a page that does not escape it."""

WITHOUT_ROADS = IncidentOptions(kinds=kinds_without_roads())
"""What pages list of maps that are unknown, without a warning."""


@pytest.fixture(scope="session")
def crossing_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the sample."""
    folder = tmp_path_factory.mktemp("pages") / "crossing"
    with open_recording(CROSSING) as recording:
        write_report(recording, folder, WITHOUT_ROADS)
    return folder


def data(page: Path, name: str, index: int = 0) -> Any:
    """Return the data in a page, a folder or a file: `report` and `recording` of one of its recordings, or the `ground`."""
    variable, key = {"report": ("REPORTS", index), "recording": ("RECORDINGS", index), "ground": ("GROUND", None)}[name]
    files = [page] if page.is_file() else sorted((page / "data").iterdir())
    text = "".join(file.read_text("utf-8") for file in files)
    value = json.JSONDecoder().raw_decode(text, text.index(f"var {variable}=") + len(variable) + 5)[0]
    value = value if key is None else value[key]
    return unpack(value) if isinstance(value, str) else value


def unpack(text: str) -> Any:
    """Return the value in a packed text, as the page's scripts read it."""
    content = zlib.decompress(base64.b64decode(text))
    (length,) = struct.unpack_from("<I", content)

    def revive(value: dict[str, Any]) -> Any:
        return numbers(content[4 + length :], *value["column"]) if "column" in value else value

    return json.loads(content[4 : 4 + length], object_hook=revive)


def numbers(content: bytes, offset: int, count: int, planes: int, unit: float, order: int) -> Any:
    """Return the numbers of a packed column."""
    raw = np.frombuffer(content, np.uint8, planes * count, offset).reshape(planes, count).astype(np.uint32)
    zigzag = (raw << (8 * np.arange(planes, dtype=np.uint32))[:, None]).sum(axis=0, dtype=np.uint32)
    values = (zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32)
    for _ in range(order):
        values = np.cumsum(values, dtype=np.int32)
    return values * unit


def record(path: Path, frames: Sequence[Mapping[str, Any]], *, tick: float = 0.05, **options: Any) -> Path:
    """Write a recording, one mapping of records per frame."""
    return write(path, frames, tick=tick, **options)


def report(source: Path, folder: Path, **options: Any) -> Path:
    """Write the page of a recording."""
    with open_recording(source) as recording:
        write_report(recording, folder, WITHOUT_ROADS, **options)
    return folder


def sampled(path: Path, rate: float = 20.0) -> SampledReplay:
    with open_recording(path) as recording:
        sampler = Sampler(rate)
        for scene in Player(recording).scenes():
            sampler.add(scene)
        return sampler.finish()


def values_at(changes: list[tuple[int, float, int]], time: float) -> dict[int, int]:
    """Return the values at a time, by the indices of the actors."""
    return {actor: value for actor, since, value in changes if since <= time + 1e-4}


def lying(replay: SampledReplay, time: float) -> dict[int, int]:
    """Return the headings of the heads of the walkers that lie, by their ids."""
    return {replay.actors[index].id: yaw for index, yaw in values_at(replay.lying, time).items() if yaw >= 0}


def marks(replay: SampledReplay, time: float) -> list[list[float]]:
    return [[], *(places.tolist() for since, places in replay.marks if since <= time + 1e-4)][-1]
