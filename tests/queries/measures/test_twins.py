"""Near misses, measures and measures over time against loops over pairs and frames, for any options and motion."""

from __future__ import annotations

import math
import os
from contextlib import closing
from typing import TYPE_CHECKING
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.formats import open_reader
from carla_recap.model.records import Spawn, attributes
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.measures import measures, time_series
from carla_recap.queries.measures import motion_table as tables
from carla_recap.queries.measures.motion_table import TYPES, MotionCollector
from carla_recap.queries.measures.near_misses import NearMissDetector
from tests.queries.conftest import write
from tests.queries.measures.events import events_of
from tests.twins.encounters import Twin

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.formats.base import Reader

EXAMPLES = int(os.environ.get("TWIN_EXAMPLES", "25"))
LIMITS = st.one_of(st.sampled_from([0.0, 1.0, 1.5, 3.0]), st.floats(-1, 1.7781).map(lambda power: min(10**power, 60.0)))


def traffic(path: Path, seed: int) -> Path:
    """Record random traffic: actors that turn, brake, vanish, jump, come back under their id, and hit each other."""
    random = np.random.default_rng(seed)
    rate = float(random.choice([2, 5, 10, 20, 30, 100]))
    frames = int(random.integers(1, 60))
    actors = int(random.integers(1, 9)) if frames < 25 else int(random.integers(1, 5))
    durations = np.full(frames, 1 / rate) if random.random() < 0.6 else random.uniform(0.2, 1.8, frames) / rate
    if random.random() < 0.2:
        durations[int(random.integers(frames))] = 2.5
    time = np.append(0.0, np.cumsum(durations[:-1]))
    span, packets = float(time[-1]), [{"transforms": [], "velocities": []} for _ in range(frames)]
    spawned, boxes = [], []
    for id in range(1, actors + 1):
        is_walker = id > 1 and random.random() < 0.25
        speed, turn = random.uniform(0, 3 if is_walker else 18), random.choice([0, random.normal(0, 0.4)])
        yaw = random.uniform(-math.pi, math.pi)
        meeting = random.uniform(0, max(span, 2))  # it is near the origin then
        braking = random.choice([0, random.uniform(0, 8)])
        here, where = [], random.normal(0, 3, 2)
        fine = np.linspace(0, max(span, 0.1), 400)
        fast = np.maximum(speed - braking * np.maximum(fine - meeting + 1, 0), 0)
        heading = yaw + turn * (fine - meeting)
        steps = np.gradient(fine)
        x, y = np.cumsum(fast * np.cos(heading) * steps), np.cumsum(fast * np.sin(heading) * steps)
        x, y = (values - np.interp(meeting, fine, values) + offset for values, offset in zip((x, y), where, strict=True))
        jump = random.uniform(0, span) if random.random() < 0.1 else math.inf
        absent = sorted(random.uniform(0, span, 2)) if random.random() < 0.2 else (math.inf, math.inf)
        has_velocity, z = random.random() < 0.7, random.choice([0, 0, 0, 0, 6]) * 100.0
        for frame, now in enumerate(time.tolist()):
            if absent[0] <= now <= absent[1]:
                continue
            px, py = (np.interp(now, fine, values) + (60 if now > jump else 0) for values in (x, y))
            angle = float(np.interp(now, fine, heading))
            v = float(np.interp(now, fine, fast))
            packets[frame]["transforms"].append((id, px * 100, -py * 100, z, 0.0, 0.0, -math.degrees(angle)))
            if has_velocity:
                velocity = (id, v * math.cos(angle), -v * math.sin(angle), 0.0, 0.0, 0.0, 0.0)
                packets[frame]["velocities"].append(velocity)
            here.append(frame)
        names = {"role_name": "hero"} if id == 1 else {}
        type_id = "walker.pedestrian.0001" if is_walker else str(random.choice(["vehicle.audi.tt", "vehicle.bh.crossbike"]))
        spawn = Spawn(id, 2 if is_walker else 1, type_id=type_id, attributes=attributes(**names))
        spawned.append(spawn)
        if random.random() < 0.5:
            boxes.append((id, random.normal(0, 20), 0.0, 75.0, *random.uniform(20, 300, 2), 75.0))
        if random.random() < 0.15 and frames > 2:
            again = int(random.integers(1, frames))
            packets[again]["destroyed"] = [*packets[again].get("destroyed", []), (id,)]
            packets[again]["spawned"] = [*packets[again].get("spawned", []), spawn]
    packets[0] = {"spawned": spawned, "bounding_boxes": boxes, **packets[0]}
    if actors > 1 and random.random() < 0.3:
        pair = random.choice(actors, 2, replace=False) + 1
        begin = int(random.integers(frames))
        for frame in range(begin, min(begin + int(random.integers(1, 4)), frames)):
            packets[frame]["collisions"] = [(0, int(pair[0]), int(pair[1]), 0, 0)]
    return write(path, packets, durations=[*durations[:-1].tolist(), -1.0])


def twin_of(reader: Reader) -> Twin:
    lives, contacts = events_of(reader)
    with patch.object(tables, "_FRAMES", 1 << 20), patch.object(tables, "_VALUES", 1 << 30):
        collector = MotionCollector(lives, contacts)
        found = [table for batch in reader.batches(TYPES) for table in collector.add(batch)]
        (table,) = [*found, *collector.finish()]
    return Twin(table, contacts)


@settings(max_examples=EXAMPLES)
@given(
    st.integers(0, 2**32 - 1), LIMITS, LIMITS, st.sampled_from([0.0, 0.0, 1.0, 3.4, 8.0]), st.sampled_from([1, 7, 23, 1024])
)
def test_near_misses(tmp_path: Path, seed: int, longest: float, soonest: float, deceleration: float, frames: int) -> None:
    with closing(open_reader(traffic(tmp_path / "traffic.mcap", seed))) as reader, patch.object(tables, "_FRAMES", frames):
        expected = twin_of(reader).near_misses(longest, soonest, deceleration)
        detector = NearMissDetector(
            *events_of(reader),
            time_to_collision=longest,
            post_encroachment_time=soonest,
            required_deceleration=deceleration,
        )
        for batch in reader.batches(TYPES):
            detector.batch(batch)
        found = detector.finish()
    assert [(each.id1, each.id2) for each in found] == [(each.id1, each.id2) for each in expected]
    for each, twin in zip(found, expected, strict=True):
        assert [getattr(each, name) for name in twin._fields] == pytest.approx(list(twin), abs=1e-6, rel=1e-6)


@settings(max_examples=EXAMPLES)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 7, 23, 1024]))
def test_measures(tmp_path: Path, seed: int, frames: int) -> None:
    """The extremes, and the values over time, of every actor."""
    with closing(open_reader(traffic(tmp_path / "traffic.mcap", seed))) as reader, patch.object(tables, "_FRAMES", frames):
        twin = twin_of(reader)
        rows = {(row.actor, row.measure): row for row in measures(reader, "all")}
        ids = sorted({actor.id for actor in twin.table.actors})
        series = {id: time_series(reader, id) for id in ids}
    crossings = twin.crossings(3.0, 1.0, only_vehicles=False)
    for id in ids:
        times, gaps, courses = [], [], []
        for row in (row for row in twin.rows if twin.table.actors[row].id == id):
            for frame, time in enumerate(twin.time):
                a = twin.poses[row][frame]
                if a is None:
                    continue
                gap = seconds = confirmed = math.inf
                for other in twin.rows:
                    b = twin.poses[other][frame]
                    if other == row or not twin.counts(row, other):
                        continue
                    if any(each.start - 1e-6 <= time <= each.stop + 1e-6 for each in twin.contacts_of(row, other)):
                        gap = seconds = confirmed = 0.0
                    if b is None or not twin.level(row, other, a, b):
                        continue
                    if math.hypot(b.x - a.x, b.y - a.y) <= 100:
                        gap = min(gap, twin.gap(row, other, a, b))
                    seconds = min(seconds, twin.touch(row, other, a, b))
                    confirmed = min(confirmed, twin.collision_course(row, other, frame, 10.0))
                times.append(time)
                gaps.append((gap, seconds if seconds <= 10 else math.inf))
                courses.append(confirmed)
        assert series[id].time.tolist() == times
        assert series[id].gap.tolist() == pytest.approx([gap for gap, _ in gaps], abs=1e-6)
        assert series[id].time_to_collision.tolist() == pytest.approx([seconds for _, seconds in gaps], abs=1e-6)
        least = {
            "gap": min((gap for gap, _ in gaps), default=math.inf),
            "time_to_collision": min(courses, default=math.inf),
            "post_encroachment_time": min(
                (miss.post_encroachment_time for _, _, miss in crossings if id in miss[:2]), default=math.inf
            ),
        }
        for name, value in least.items():
            found = rows[id, name].value if (id, name) in rows else math.inf
            assert found == pytest.approx(value, abs=1e-6), name


@settings(max_examples=EXAMPLES)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10))
def test_near_misses_are_those_of_the_measure(tmp_path: Path, seed: int, limit: float) -> None:
    """Where the hero hits nothing, it has a near miss by time to collision exactly if the measure is as short."""
    with closing(open_reader(traffic(tmp_path / "traffic.mcap", seed))) as reader:
        _, contacts = events_of(reader)
        found = incidents(reader, IncidentOptions(kinds=["near miss"], time_to_collision=limit))
        least = min((row.value for row in measures(reader, "hero") if row.measure == "time_to_collision"), default=math.inf)
    if not any(1 in contact.ids for contact in contacts):
        near = [row.value for row in found if row.measure == "time_to_collision" and 1 in row.actors]
        assert min(near, default=math.inf) == (least if least <= limit else math.inf)
