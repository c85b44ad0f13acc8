"""Speeds at collisions, and answers of `collisions` and `incidents` from the digest of an MCAP file and without it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.editing.convert import convert
from carla_recap.formats.base import PartName, Reader
from carla_recap.formats.mcap.reader import McapReader
from carla_recap.model.frame import Frame, Header
from carla_recap.model.records import NO_ACTOR, Spawn
from carla_recap.queries import contacts as contacts_module
from carla_recap.queries.collisions import collisions
from carla_recap.queries.incidents import IncidentOptions, incidents
from tests import strategies
from tests.queries.conftest import Make
from tests.queries.measures.traffic import traffic
from tests.samples import reading, warnings_ignored
from tests.samples import write as write_frames

CAST = [Spawn(1, 1, type_id="vehicle.a"), Spawn(2, 2, type_id="walker.b"), Spawn(3, 3, type_id="traffic.traffic_light")]


def poses(*places: tuple[int, float, float, float]) -> dict[str, Any]:
    """Transforms; positions are in cm."""
    return {"transforms": [(id, x, y, z, 0.0, 0.0, 0.0) for id, x, y, z in places]}


def moving(*speeds: tuple[int, float, float, float]) -> dict[str, Any]:
    return {"velocities": poses(*speeds)["transforms"]}


# --- definitions ---------------------------------------------------------------------------------------------------------

ONE = {"spawned": CAST} | moving((1, 0, 5, 0))
AT = poses((1, 0, 0, 0))


@pytest.mark.parametrize(
    ("before", "pair", "impact", "relative"),
    [
        ([moving((1, 9, 9, 9)), {"spawned": CAST} | moving((1, 3, 4, 12), (2, 3, -4, 12))], (1, 2), 13, 8),
        # Positions say it that are 0.5 s apart.
        ([poses((1, 100 * n, 0, 0), (2, 0, 200 * n, 0)) for n in range(2)], (1, 2), 2, math.hypot(2, 4)),
        *[([ONE], (1, other), 5, 5) for other in (NO_ACTOR, 0, 3)],  # what never moves stands still
        ([ONE], (3, 1), 0, 5),
        ([moving((1, 0, 0, 2))], (1, 2), 2, math.nan),
        *[
            (before, (1, 2), math.nan, math.nan)
            for before in (
                [],
                [{}],
                [poses((1, 0, 0, 0), (2, 0, 0, 0))],
                [AT, {}],
                [{}, AT],
                [AT, poses((1, 5001, 0, 0))],
                [AT, poses((1, math.nan, 0, 0))],
                [moving((1, math.nan, 0, 0))],
                [moving((1, 1, 0, 0)), {}],
            )
        ],
    ],
)
def test_speeds_are_those_of_the_frame_before(
    make: Make, before: list[dict[str, Any]], pair: tuple[int, int], impact: float, relative: float
) -> None:
    hit = {"collisions": [(0, *pair, 0, 0)]} | moving((1, 1, 0, 0), (2, 1, 0, 0)) | poses((1, 5000, 0, 0), (2, 0, 5000, 0))
    (row,) = collisions(make(*before, hit))
    assert (row.impact_speed, row.relative_speed) == pytest.approx((impact, relative), nan_ok=True)


def test_positions_far_apart_in_time_give_no_speed(make: Make) -> None:
    frames = [poses((1, n, 0, 0), (2, n, 0, 0)) for n in range(2)]
    (row,) = collisions(make(*frames, {"collisions": [(0, 1, 2, 0, 0)]}, durations=[1.5, 0.1, 0.1]))
    assert math.isnan(row.impact_speed)


# --- the same answers with the digest and without ------------------------------------------------------------------------

OPTIONS: list[dict[str, Any]] = [
    {},
    {"kinds": ["blocked", "hard braking"], "deceleration": 3.0},
    {"kinds": ["collision", "hard braking"], "start": 2.0},
    {"kinds": ["collision"], "start": 1.0, "stop": 3.0},
]


class WithoutDigest(McapReader):
    """A reader of files without a digest."""

    def digest(self, part: PartName) -> None:
        return None


def answers(reader: Reader) -> Iterator[str]:
    for type1, type2 in (("a", "a"), ("h", "a"), ("v", "w")):
        yield repr(list(collisions(reader, type1, type2)))
    for options in OPTIONS:
        yield repr(list(incidents(reader, IncidentOptions(min_time=1.0, **options))))


def assert_equal_answers(*paths: Path) -> list[str]:
    found = []
    for path in paths:
        with reading(path) as reader:
            found.append(list(answers(reader)))
        if path.suffix == ".mcap":
            with closing(WithoutDigest(path)) as without:
                found.append(list(answers(without)))
    assert all(each == found[0] for each in found)
    return found[0]


def crowd(folder: Path, seed: int) -> tuple[Header, list[Frame]]:
    """Return random traffic whose actors touch each other again and again."""
    random = np.random.default_rng(seed)
    with reading(traffic(folder / "traffic.log", seed)) as reader:
        frames = list(reader.frames())
        for number in np.flatnonzero(random.random(len(frames)) < 0.3).tolist():
            pairs = random.choice([1, 2, 3, 4, NO_ACTOR], (int(random.integers(1, 4)), 2)).tolist()
            hits = [(0, a, b, int(random.random() < 0.2), 0) for a, b in pairs]
            frames[number] = frames[number].replace(collisions=hits)
        return reader.header, frames


@settings(max_examples=8)
@given(seed=st.integers(0, 1 << 20))
def test_a_crowd(tmp_path: Path, seed: int) -> None:
    one_by_one, log = (write_frames(tmp_path / name, *crowd(tmp_path, seed)) for name in ("one-by-one.mcap", "crowd.log"))
    convert(log, tmp_path / "crowd.mcap", force=True)
    assert_equal_answers(log, one_by_one, tmp_path / "crowd.mcap")


@settings(max_examples=25)
@given(recording=strategies.recordings())
def test_any_recording(tmp_path: Path, recording: tuple[Header, list[Frame]]) -> None:
    with warnings_ignored():
        mcap, log = (write_frames(tmp_path / name, *recording) for name in ("any.mcap", "any.log"))
        assert_equal_answers(mcap, log)


def test_too_many_look_ups_read_all_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_frames(tmp_path / "crowd.mcap", *crowd(tmp_path, 5))
    with reading(path) as reader, closing(WithoutDigest(path)) as without:
        expected = list(answers(reader))
        monkeypatch.setattr(contacts_module, "LOOK_UPS", 0)
        assert list(answers(without)) == expected
