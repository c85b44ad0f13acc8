"""Near misses, measures and measures over time against loops over pairs and frames, for any options and motion."""

from __future__ import annotations

import math
import os
from collections import defaultdict
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import MOTION
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.measures import encroachment, measures, time_series
from carla_recap.queries.measures import motion_table as tables
from carla_recap.queries.measures.definitions import NO_OTHER
from carla_recap.queries.measures.encroachment import Encounter
from carla_recap.queries.measures.motion_table import MotionCollector
from carla_recap.queries.measures.near_misses import NearMissDetector
from carla_recap.queries.recorded_actors import lives_and_contacts
from tests.queries.measures.traffic import approach, crossing, traffic
from tests.twins.encounters import Twin

OTHERS = ("nearest", "threat", "leader")
EXAMPLES = int(os.environ.get("TWIN_EXAMPLES", "10"))
LIMITS = st.one_of(st.sampled_from([0.0, 1.0, 1.5, 3.0]), st.floats(-1, 1.7781).map(lambda power: min(10**power, 60.0)))


def twin_of(reader: Reader) -> Twin:
    lives, contacts = lives_and_contacts(reader)
    with patch.object(tables, "_FRAMES", 1 << 20), patch.object(tables, "_VALUES", 1 << 30):
        collector = MotionCollector(lives, contacts)
        found = [table for batch in reader.batches(MOTION) for table in collector.add(batch)]
        (table,) = [*found, *collector.finish()]
    return Twin(table, lives, contacts)


def near_misses(reader: Reader, longest: float, soonest: float, deceleration: float) -> list[Encounter]:
    limits = {"time_to_collision": longest, "post_encroachment_time": soonest, "required_deceleration": deceleration}
    detector = NearMissDetector(*lives_and_contacts(reader), **limits)
    for batch in reader.batches(MOTION):
        detector.batch(batch)
    return detector.finish()


@settings(max_examples=EXAMPLES)
@example(4186472194, 1.0, 0.12287142939322877, 3.4, 7, 16)  # an actor that turns where it stands
@example(3614351163, 3.0, 1.5, 8.0, 1024, 16)  # a time that is equal to its limit
@given(
    st.integers(0, 2**32 - 1),
    LIMITS,
    LIMITS,
    st.sampled_from([0.0, 0.0, 1.0, 3.4, 8.0]),
    st.sampled_from([1, 7, 23, 1024]),
    st.sampled_from([5, 16, 1000]),
)
def test_near_misses(
    tmp_path: Path, seed: int, longest: float, soonest: float, deceleration: float, frames: int, moments: int
) -> None:
    with (
        closing(open_reader(traffic(tmp_path / "traffic.mcap", seed))) as reader,
        patch.object(tables, "_FRAMES", frames),
        patch.object(encroachment, "_BLOCK", moments),
    ):
        expected = twin_of(reader).near_misses(longest, soonest, deceleration)
        found = near_misses(reader, longest, soonest, deceleration)
    assert [(each.one.id, each.other.id) for each in found] == [(each.id1, each.id2) for each in expected]
    for each, twin in zip(found, expected, strict=True):
        assert [getattr(each, name) for name in twin._fields[2:]] == pytest.approx(list(twin[2:]), abs=1e-6, rel=1e-6)


@pytest.mark.parametrize(
    ("record", "name", "value", "by", "others"),
    [
        (crossing, "speed", 1.0, 1e-3, {}),
        (crossing, "faster", 3.0, 1e-3, {}),
        (crossing, "turn", 30.0, 0.1, {}),
        (crossing, "turn", 150.0, 0.1, {"time_to_collision": 0.0, "lag": 1.1}),
        (crossing, "z", 1.5, 1e-3, {}),
        (crossing, "lag", 1.0, 0.01, {}),
        (crossing, "contact", 8.75, 0.15, {}),
        (crossing, "contact", 0.95, 0.15, {"of": (1, 3)}),
        (approach, "closest", 1.5, 1e-3, {}),
        (approach, "closest", 1.2, 1e-3, {"deceleration": 5.0}),
        (approach, "beside", 2.0, 1e-3, {}),
        (approach, "z", 2.0, 1e-3, {}),
        (approach, "pause", 3.0, 0.1, {}),
        (approach, "contact", 9.0, 0.1, {}),
        (approach, "contact", 1.0, 0.1, {"of": (1, 3)}),
    ],
)
def test_near_misses_just_below_and_just_above_what_decides(
    tmp_path: Path, record: Any, name: str, value: float, by: float, others: dict[str, Any]
) -> None:
    limits = {"time_to_collision": 1.5, "deceleration": 0.0} | others
    longest, deceleration = limits.pop("time_to_collision"), limits.pop("deceleration")
    found = []
    for each in (value - by, value + by):
        with closing(open_reader(record(tmp_path / "met.mcap", **{name: each, **limits}))) as reader:
            expected = twin_of(reader).near_misses(longest, 1.0, deceleration)
            found.append([each.stop for each in near_misses(reader, longest, 1.0, deceleration)])
        assert found[-1] == pytest.approx([each.stop for each in expected])
    assert found[0] != found[1]


@settings(max_examples=EXAMPLES)
@example(1117692447, 7)  # an actor that turns where it stands
@example(840531376, 1)  # two actors overlap a third one
@example(2805, 1)  # two leaders at the distance 0
@example(34194, 1)  # a leader at the distance 0 of an actor whose speed is unknown
@example(2629714983, 1)  # a contact with an actor that has no pose around then
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 7, 23, 1024]))
def test_measures(tmp_path: Path, seed: int, frames: int) -> None:
    """The extremes, and the values over time, of every actor."""
    with closing(open_reader(traffic(tmp_path / "traffic.mcap", seed))) as reader, patch.object(tables, "_FRAMES", frames):
        twin = twin_of(reader)
        rows: dict[tuple[int, str], list[float]] = defaultdict(list)  # of each that had an id, in order
        for found in measures(reader, "all"):
            rows[found.actor, found.measure].append(found.value)
        ids = sorted({actor.id for actor in twin.table.actors})
        series = {id: time_series(reader, id) for id in ids}
    crossings = twin.crossings(3.0, 1.0, only_vehicles=False)
    extremes: dict[tuple[int, str], list[float]] = defaultdict(list)
    for id in ids:
        times, gaps, courses, headways, braking, named = [], [], [], [], [], []
        for row in (row for row in twin.rows if twin.table.actors[row].id == id):
            first = len(times)
            for frame, time in enumerate(twin.time):
                a = twin.poses[row][frame]
                if a is None:
                    continue
                gap = seconds = ahead = math.inf, NO_OTHER  # with the other actor, of several alike that of the least id
                confirmed, leader = math.inf, None
                for other in twin.rows:
                    b, met = twin.poses[other][frame], twin.table.actors[other].id
                    if other == row or not twin.counts(row, other):
                        continue
                    if any(frame in twin.touching(row, each) for each in twin.contacts_of(row, other)):
                        gap, seconds, confirmed = min(gap, (0.0, met)), min(seconds, (0.0, met)), 0.0
                    if b is None or not twin.level(row, other, a, b):
                        continue
                    if math.hypot(b.x - a.x, b.y - a.y) <= 100:
                        gap = min(gap, (twin.gap(row, other, a, b), met))
                        if (distance := twin.headway(row, other, a, b)) < ahead[0]:
                            ahead, leader = (distance, met), b
                    if (until := twin.touch(row, other, a, b)) <= 10:
                        seconds = min(seconds, (until, met))
                    confirmed = min(confirmed, twin.collision_course(row, other, frame, 10.0))
                headway = ahead[0]
                times.append(time)
                named.append((gap[1], seconds[1], ahead[1]))
                gaps.append((gap[0], seconds[0]))
                courses.append(confirmed)
                headways.append((headway, headway / twin.forwards(a) if twin.forwards(a) > 0 else math.inf))
                braking.append(twin.braking(a, leader, headway) if leader else 0.0)
            least = {
                "gap": min((gap for gap, _ in gaps[first:]), default=math.inf),
                "time_to_collision": min(courses[first:], default=math.inf),
                "distance_headway": min((each for each, _ in headways[first:]), default=math.inf),
                "time_headway": min((each for _, each in headways[first:]), default=math.inf),
                "post_encroachment_time": min(
                    (miss.post_encroachment_time for *pair, miss in crossings if row in pair), default=math.inf
                ),
            }
            for name, value in least.items():
                extremes[id, name] += [value] if value < math.inf else []
        assert series[id].time.tolist() == times
        assert list(zip(*(getattr(series[id], name).tolist() for name in OTHERS), strict=True)) == named
        assert series[id].gap.tolist() == pytest.approx([gap for gap, _ in gaps], abs=1e-6)
        assert series[id].time_to_collision.tolist() == pytest.approx([seconds for _, seconds in gaps], abs=1e-6)
        assert series[id].distance_headway.tolist() == pytest.approx([each for each, _ in headways], abs=1e-6)
        assert series[id].time_headway.tolist() == pytest.approx([each for _, each in headways], abs=1e-6, rel=1e-6)
        assert series[id].required_deceleration.tolist() == pytest.approx(braking, abs=1e-6, rel=1e-5, nan_ok=True)
    for key, values in extremes.items():
        assert rows[key] == pytest.approx(values, abs=1e-6), key


@settings(max_examples=EXAMPLES)
@given(st.integers(0, 2**32 - 1), st.floats(-0.1, 1.1), st.floats(-0.1, 1.1), st.sampled_from([1, 7, 1024]))
def test_a_part_has_the_values_of_the_whole(tmp_path: Path, seed: int, one: float, other: float, frames: int) -> None:
    with closing(open_reader(traffic(tmp_path / "traffic.mcap", seed))) as reader, patch.object(tables, "_FRAMES", frames):
        twin = twin_of(reader)
        start, stop = (share * twin.time[-1] for share in sorted((one, other)))
        rows = {(row.actor, row.measure): row for row in measures(reader, "all", start=start, stop=stop)}
        for id in {actor.id for actor in twin.table.actors}:
            whole, part = time_series(reader, id), time_series(reader, id, start=start, stop=stop)
            kept = (whole.time >= start - SAME_TIME) & (whole.time < stop - SAME_TIME)
            for name, values in part.columns().items():
                assert values.tolist() == pytest.approx(getattr(whole, name)[kept].tolist(), abs=1e-9, nan_ok=True), name
            if (id, "gap") in rows and list(twin.table.ids).count(id) == 1:
                assert rows[id, "gap"].value == part.gap.min()
                assert start - SAME_TIME <= rows[id, "gap"].time < stop - SAME_TIME


@settings(max_examples=EXAMPLES)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10))
def test_near_misses_are_those_of_the_measure(tmp_path: Path, seed: int, limit: float) -> None:
    """Where the hero hits nothing, it has a near miss by time to collision exactly if the measure is as short."""
    with closing(open_reader(traffic(tmp_path / "traffic.mcap", seed))) as reader:
        _, contacts = lives_and_contacts(reader)
        found = incidents(reader, IncidentOptions(kinds=["near miss"], time_to_collision=limit))
        least = min((row.value for row in measures(reader, "hero") if row.measure == "time_to_collision"), default=math.inf)
    if not any(1 in contact.ids for contact in contacts):
        near = [row.value for row in found if row.measure == "time_to_collision" and 1 in row.actors]
        assert min(near, default=math.inf) == (least if least <= limit else math.inf)
