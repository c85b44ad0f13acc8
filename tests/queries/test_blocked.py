from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.errors import RecapError
from carla_recap.model.frame import Header
from carla_recap.model.records import Spawn
from carla_recap.output.text import text
from carla_recap.queries.blocked import blocked
from carla_recap.queries.incidents import IncidentOptions, incidents
from tests.queries.conftest import Make
from tests.twins.stationary import stationary


def spawn(id: int, type_id: str = "vehicle.a") -> Spawn:
    return Spawn(id, 1, 0, 0, 0, 0, 0, 0, 0, type_id)


def at(*places: tuple[int, float]) -> dict[str, Any]:
    """Transforms: ids and x in cm."""
    return {"transforms": [(id, x, 0, 0, 0, 0, 0) for id, x in places]}


@pytest.mark.parametrize(
    ("spawned", "order"),
    [
        ((5, 1, 9, 4), (4, 9, 1, 5)),
        ((1, 2, 6), (2, 6, 1)),
        ((1, 2, 6, 11, 3, 4), (4, 3, 2, 11, 6, 1)),
        ((4294967295, 10, 21, 32, 1), (32, 1, 21, 10, 4294967295)),
    ],
)
def test_carla_goes_through_a_hash_table(make: Make, spawned: tuple[int, ...], order: tuple[int, ...]) -> None:
    """Of intervals of the same length, those that last until the end come in the order of libc++'s `unordered_map`."""
    standing = at(*((id, 1) for id in sorted(spawned)))
    reader = make({"spawned": [spawn(id) for id in spawned], **standing}, standing, {})
    assert tuple(row.id for row in blocked(reader, 0.5, compat=True)) == order
    unknown = make(at(*((id, 1) for id in spawned)), at(*((id, 1) for id in spawned)), {})
    assert tuple(row.id for row in blocked(unknown, 0.5, compat=True)) == order


@pytest.mark.parametrize("compat", [False, True])
def test_the_footer_keeps_its_decimals(make: Make, compat: bool) -> None:
    printed = "".join(text(blocked(make(at((1, 1)), at((1, 1)), {}, durations=[0.5, 0.75, 1.0]), 0.5, compat=compat)))
    assert len(printed.splitlines()) == 9
    assert printed.endswith("\n\nFrames: 3\nDuration: 1.25 seconds\n")


def test_double_precision(make: Make) -> None:
    """Lengths in double precision are compared so: 1e9 cm and a few are the same position in single precision."""
    wide = Header("Town10HD", 0, wide=True)
    far = [at((1, 1e9)), at((1, 1e9 + 12)), at((1, 1e9 + 24)), {}]
    assert blocked(make(*far, header=wide), 0.5) == []
    assert blocked(make(*far), 0.5) != []


ids = st.integers(1, 5)
lengths = st.one_of(
    st.sampled_from([0.0, 3.0, 5.0, 9.999999, 10.0, 10.000001, 20.0, 26.0, 4000.0, 1e30, math.nan, math.inf]),
    st.floats(-1e6, 1e6, width=32),
)
angles = st.sampled_from([0, 0, 359.75, 60, 90, -61, -300, 450])
place = st.tuples(ids, lengths, lengths, st.just(0.0), angles, st.just(0), angles)
packets = st.one_of(
    st.builds(lambda rows: {"transforms": rows}, st.lists(place, min_size=1, max_size=6)),
    st.builds(lambda rows: {"transforms": rows}, st.lists(place, min_size=1, max_size=6)),
    st.builds(lambda rows: {"transforms": rows}, st.permutations([(id, 3, 0, 0, 0, 0, 0) for id in range(1, 6)])),
    st.builds(
        lambda chosen: {"spawned": [spawn(id, f"x{id}" if id % 2 else "walker.a") for id in chosen]},
        st.lists(ids, min_size=1, max_size=2),
    ),
    st.builds(lambda chosen: {"destroyed": [(id,) for id in chosen]}, st.lists(ids, min_size=1, max_size=2)),
)
frames = st.lists(st.lists(packets, max_size=4), min_size=1, max_size=12)
stays = st.integers(1, 30).map(lambda count: [[{"transforms": [(id, 3, 0, 0, 0, 0, 0) for id in range(1, 6)]}]] * count)
lasting = st.one_of(st.sampled_from([0.5, 0.1, 1.0, 0.0, -1.0, 30.0, 400.0]), st.floats(0, 500))
times = st.one_of(st.sampled_from([0.0, 0.1, 0.5, 1.0, 30.0]), st.floats(0, 1000))
distances = st.one_of(st.sampled_from([0.0, 0.3, 5.0, 10.0, 5000.0, 1e30, math.inf]), st.floats(0, 1e6))


@pytest.mark.parametrize("compat", [False, True])
@settings(max_examples=20)
@given(
    frames=st.lists(st.one_of(frames, stays), max_size=3).map(lambda found: [frame for some in found for frame in some]),
    data=st.data(),
    min_time=times,
    min_distance=distances,
)
def test_as_the_twin_has_it(
    make: Make, compat: bool, frames: Any, data: st.DataObject, min_time: float, min_distance: float
) -> None:
    durations = data.draw(st.lists(lasting, min_size=len(frames), max_size=len(frames)))
    reader = make(*frames, durations=durations)
    rows = blocked(reader, min_time, min_distance, compat=compat)
    with np.errstate(all="ignore"):
        wanted = stationary(reader, min_time, min_distance, compat=compat)
    assert repr([(row.start, row.duration, row.id, row.type_id, (row.x, row.y, row.z)) for row in rows]) == repr(wanted)


@pytest.mark.parametrize("limit", [-1.0, math.nan])
def test_limits_below_0_are_for_carlas_answer_alone(make: Make, limit: float) -> None:
    reader = make({"transforms": [(1, 0, 0, 0, 0, 0, 0)]}, {})
    with pytest.raises(RecapError, match="min_time: expected 0 s or more, found"):
        blocked(reader, limit)
    with pytest.raises(RecapError, match="min_distance: expected 0 cm or more, found"):
        blocked(reader, 1, limit)
    with pytest.raises(RecapError, match="min_time: expected 0 s or more, found"):
        IncidentOptions(min_time=limit)
    blocked(reader, limit, compat=True)


@pytest.mark.parametrize("with_digest", [True, False])
def test_incidents_of_a_part_have_the_stops_that_overlap_it(make: Make, with_digest: bool) -> None:
    frames = [{"spawned": [spawn(1)], **at((1, 100))}, *[at((1, 100))] * 199, at((1, 900)), at((1, 1800))]
    limits = {"kinds": ["blocked"], "min_distance": 10 if with_digest else 11}
    for start, stop, count in ((50, 60, 1), (0, 1, 1), (99, 1000, 1), (102, 1000, 0), (-math.inf, 0.2, 0)):
        found = incidents(make(*frames), IncidentOptions(start=start, stop=stop, **limits))
        assert [(row.start, row.stop) for row in found] == [(0.5, 100.0)] * count
