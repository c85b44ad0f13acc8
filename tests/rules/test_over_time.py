"""Conditions that judge over time, compared with loops over the moments."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn
from carla_recap.queries.measures import MeasureValues
from carla_recap.queries.measures.series import NO_OTHER
from carla_recap.rules.measures import MeasureBounds
from carla_recap.rules.places import Circle
from carla_recap.rules.progress import Stays
from carla_recap.rules.scope import Scope
from carla_recap.rules.values import Bounds, Quantity, Selector
from tests.twins.conditions import longest_valid, offending

LIFE = ActorLife(1, "vehicle.a", "vehicle", "hero", 0.0, spawn=Spawn(1, 1))
SAME_TIME = 1e-6

steps = st.sampled_from([0.05, 0.1, 0.5, 1.0, 1.000002, 3.0]) | st.floats(0.01, 2)
drives = st.lists(st.tuples(steps, st.integers(-2, 2)), min_size=1, max_size=20).map(
    lambda rows: (np.cumsum([step for step, _ in rows]), np.array([float(value) for _, value in rows]))
)
times = st.sampled_from([0.0, 0.05, 0.1, 0.5, 1.0, 2.0]) | st.floats(0, 20)
limits = st.none() | st.integers(-2, 2)


def facts_of(time: Any, values: Any) -> Any:
    """Answers about a recording of one actor."""
    measured = MeasureValues(time, values, np.full(len(time), NO_OTHER))
    actors = SimpleNamespace(name=lambda id, time: "hero")
    return SimpleNamespace(
        actors=type("Lives", (list,), {"name": staticmethod(actors.name)})([LIFE]),
        values=lambda measure, life: measured,
        positions=lambda life: SimpleNamespace(time=time),
        outside=lambda place, life: np.maximum(values, 0.0),
        subjects=lambda of: [LIFE],
        absent=lambda of: "",
        recording=SimpleNamespace(reader=SimpleNamespace(extent=lambda: SimpleNamespace(duration=float(time[-1])))),
    )


def during(start: float, length: float) -> tuple[Scope, Any]:
    stop = start + length
    scope = Scope(during=(Quantity(start, "s"), Quantity(stop, "s")))
    return scope, lambda time: [start - SAME_TIME <= t <= stop + SAME_TIME for t in time]


def quantity(value: float | None, unit: str = "") -> Quantity | None:
    return None if value is None else Quantity(value, unit)


def is_close(times: list[float], limit: float | None) -> bool:
    """Return whether a duration is so near to the limit that rounding decides."""
    apart = [abs(b - a - limit) for a in times for b in times] if limit is not None else []
    return any(0 < abs(each - SAME_TIME) < 1e-9 for each in apart)


@given(drives, limits, limits, st.none() | times, st.none() | times, times, times)
def test_measures_over_time_are_judged_as_by_a_loop(
    drive: Any,
    least: int | None,
    most: int | None,
    tolerate: float | None,
    lasting: float | None,
    start: float,
    length: float,
) -> None:
    if least is None and most is None:
        most = 0
    time, values = drive
    scope, counting = during(start, length)
    counts = counting(time.tolist())
    bounds = Bounds(quantity(least, "m/s"), quantity(most, "m/s"))
    condition = MeasureBounds("speed", Selector("hero"), bounds, scope, quantity(tolerate, "s"), quantity(lasting, "s"))
    found = condition.judge(facts_of(time, values))
    valid = [(least is None or v >= least) and (most is None or v <= most) for v in values.tolist()]
    if is_close(time.tolist(), tolerate) or is_close(time.tolist(), lasting):
        return
    if not any(counts):
        assert found.passes
    elif lasting is not None:
        assert found.passes == (longest_valid(time.tolist(), counts, valid, tolerate) >= lasting - SAME_TIME)
    else:
        expected = offending(time.tolist(), counts, valid, tolerate)
        assert found.passes == (not expected)
        spans = [(time[each[0]], time[each[-1]]) for each in expected]
        assert sorted(spans) == sorted(
            span for offence in found.offences for span in spans if span[0] <= (offence.time or 0.0) <= span[1]
        )


@given(drives, st.booleans(), st.none() | times, times, times)
def test_stays_are_judged_as_by_a_loop(
    drive: Any, is_inside: bool, tolerate: float | None, start: float, length: float
) -> None:
    time, values = drive
    scope, counting = during(start, length)
    place = Circle(0.0, 0.0, None, Quantity(1.0, "m"), "[0, 0]")
    condition = Stays(Selector("hero"), place, is_inside, quantity(tolerate, "s"), scope)
    found = condition.judge(facts_of(time, values))
    if is_close(time.tolist(), tolerate):
        return
    valid = [(value <= 0) == is_inside for value in values.tolist()]
    expected = offending(time.tolist(), counting(time.tolist()), valid, tolerate)
    if scope.has_any(LIFE, facts_of(time, values)):
        assert [offence.time for offence in found.offences] == [time[each[0]] for each in expected]
        assert found.passes == (not expected)
