"""Conditions that judge over time, compared with loops over the moments."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn
from carla_recap.queries.measures import MeasureValues
from carla_recap.rules.facts import Facts, Scope
from carla_recap.rules.measures import MeasureBounds
from carla_recap.rules.places import Circle
from carla_recap.rules.progress import Stays
from carla_recap.rules.values import Bounds, Quantity, Selector
from tests.twins.conditions import LONGEST_STEP, SAME_TIME, first_time, longest_valid, offending, within

steps = st.sampled_from([0.05, 0.1, 0.5, 1.0, 1.000002, 3.0]) | st.floats(0.01, 2)
times = st.sampled_from([0.0, 0.05, 0.1, 0.5, 1.0, 2.0]) | st.floats(0, 20)
limits = st.none() | st.integers(-2, 2)


@dataclass(eq=False)
class Drive(Facts):
    """A drive of an actor: a measure over time, and positions at other times, of which some are in two places."""

    time: Any
    measured: Any
    known: Any
    inside: dict[Circle, list[bool]]
    hits: list[tuple[float, bool]]
    life: ActorLife

    def __post_init__(self) -> None:
        self.answers = {}
        extent = SimpleNamespace(duration=max(self.time[-1], self.known[-1]))
        self.recording: Any = SimpleNamespace(reader=SimpleNamespace(extent=lambda: extent))

    def first_by_loop(self, occasion: str | Circle) -> float:
        life = (self.life.spawned_at, self.life.end)
        if isinstance(occasion, str):
            return first_time([start for start, is_own in self.hits if is_own], life)
        return first_time([t for t, is_in in zip(self.known, self.inside[occasion], strict=True) if is_in], (-9e9, 9e9))

    def counts(self, scope: Scope, time: Any) -> list[bool]:
        """Return which moments are within a scope, one by one."""
        during = scope.during and (scope.during[0].value, scope.during[1].value)
        after, until = (None if each is None else self.first_by_loop(each) for each in (scope.after, scope.until))
        where = scope.where and (self.known.tolist(), self.inside[scope.where])
        return [within(moment, during, after, until, where) for moment in time.tolist()]

    # --- answers about its recording ---

    @property
    def actors(self) -> Any:
        return type("Lives", (list,), {"name": staticmethod(lambda id, time: "hero")})([self.life])

    @property
    def incidents(self) -> Any:
        rows = sorted(self.hits)
        return [SimpleNamespace(kind="collision", start=start, actors=(1,) if is_own else (2,)) for start, is_own in rows]

    def values(self, measure: str, life: ActorLife, other: Selector) -> MeasureValues:
        return MeasureValues.of(self.time, self.measured)

    def subjects(self, of: Selector) -> list[ActorLife]:
        return [self.life]

    def positions(self, life: ActorLife) -> Any:
        return SimpleNamespace(time=self.known)

    def outside(self, place: Any, life: ActorLife) -> Any:
        return np.where(self.inside[place], 0.0, 1.0)


PLACES = [Circle(x, 0.0, None, Quantity(1.0, "m"), f"({x})") for x in (0.0, 9.0)]
moments = st.lists(steps, min_size=1, max_size=20).map(np.cumsum)


@st.composite
def drives(draw: Any) -> Drive:
    time, known = draw(moments), draw(moments)
    values = np.array([draw(st.sampled_from([-2.0, -1.0, 0.0, 1.0, 2.0, np.nan])) for _ in time])
    inside = {place: [draw(st.booleans()) for _ in known] for place in PLACES}
    incidents = draw(st.lists(st.tuples(times | st.sampled_from(time.tolist()), st.booleans()), max_size=3))
    ends = [float(min(time[0], known[0])), float(max(time[-1], known[-1]))]
    start, stop = draw(st.sampled_from([0.0, ends[0]])), draw(st.sampled_from([None, ends[1], ends[1] + 1]))
    life = ActorLife(1, "vehicle.a", "vehicle", "hero", start, stop, spawn=Spawn(1, 1))
    return Drive(time, values, known, inside, incidents, life)


occasions = st.none() | st.just("collision") | st.sampled_from(PLACES)
intervals = st.none() | st.tuples(times, times).map(lambda pair: (Quantity(pair[0], "s"), Quantity(sum(pair), "s")))
scopes = st.builds(Scope, intervals, occasions, occasions, st.none() | st.sampled_from(PLACES))


def quantity(value: float | None, unit: str = "") -> Quantity | None:
    return None if value is None else Quantity(value, unit)


def is_close(times: list[float], limit: float | None) -> bool:
    """Return whether a duration is so near to the limit that rounding decides."""
    apart = [abs(b - a - limit) for a in times for b in times] if limit is not None else []
    return any(0 < abs(each - SAME_TIME) < 1e-9 for each in apart)


@settings(max_examples=5 * settings.default.max_examples)  # few have values that are none within the scope
@given(drives(), limits, limits, st.none() | times, st.none() | times, scopes)
def test_measures_over_time_are_judged_as_by_a_loop(
    drive: Drive, least: int | None, most: int | None, tolerate: float | None, lasting: float | None, scope: Scope
) -> None:
    if least is None and most is None:
        most = 0
    if scope.is_whole:  # of which extreme values are enough
        scope = Scope(during=(Quantity(0.0, "s"), Quantity(9e9, "s")))
    time = drive.time.tolist()
    counts = [
        counts and value == value for counts, value in zip(drive.counts(scope, drive.time), drive.measured, strict=True)
    ]
    bounds = Bounds(quantity(least, "m/s"), quantity(most, "m/s"))
    condition = MeasureBounds("speed", Selector("hero"), bounds, scope, quantity(tolerate, "s"), quantity(lasting, "s"))
    found = condition.judge(drive)
    valid = [(least is None or v >= least) and (most is None or v <= most) for v in drive.measured.tolist()]
    if is_close(time, tolerate) or is_close(time, lasting):
        return
    if not any(counts):
        assert found.passes
    elif lasting is not None:
        assert found.passes == (longest_valid(time, counts, valid, tolerate) >= lasting - SAME_TIME)
    else:
        expected = offending(time, counts, valid, tolerate, LONGEST_STEP if tolerate is None else np.inf)
        assert found.passes == (not expected)
        spans = [(time[each[0]], time[each[-1]]) for each in expected]
        assert sorted(spans) == sorted(
            span for offence in found.offences for span in spans if span[0] <= (offence.time or 0.0) <= span[1]
        )


@given(drives(), st.booleans(), st.none() | times, scopes)
def test_stays_are_judged_as_by_a_loop(drive: Drive, is_inside: bool, tolerate: float | None, scope: Scope) -> None:
    place, known = PLACES[0], drive.known.tolist()
    found = Stays(Selector("hero"), place, is_inside, quantity(tolerate, "s"), scope).judge(drive)
    if is_close(known, tolerate):
        return
    valid = [each == is_inside for each in drive.inside[place]]
    counts = drive.counts(scope, drive.known)
    expected = offending(known, counts, valid, tolerate, np.inf)
    if any(counts):
        assert [offence.time for offence in found.offences] == [known[each[0]] for each in expected]
        assert found.passes == (not expected)
    else:
        assert not expected
