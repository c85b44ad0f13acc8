"""Every query with every option gives the same rows, texts, errors and warnings of a log and of its conversion to MCAP."""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from carla_recap import FormatError, RecapError, Recording, convert, open_recording
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import UE4
from carla_recap.output import differences, json, text
from carla_recap.queries.info import info
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.measures import measures_over_time
from carla_recap.queries.recorded_actors import actors
from carla_recap.roads.surfaces import build_network
from carla_recap.tables import Rows, Tabular
from tests.queries.measures.traffic import LIGHT, traffic
from tests.roads.straight_road import STRAIGHT_ROAD
from tests.samples import warnings_ignored, write
from tests.strategies import recordings

EXAMPLES: Final = int(os.environ.get("TWIN_EXAMPLES", "30"))

PHASES: Final = [phase for phase in Phase if phase not in (Phase.explain,)]

TIMES = st.one_of(st.floats(-1, 8), st.sampled_from([0.0, 0.5, math.inf, -math.inf, math.nan]), st.floats())
LIMITS = st.one_of(
    st.floats(0, 12), st.floats(0, 5000), st.sampled_from([0.0, 6.0, 10.0, 30.0, 60.0, math.nan]), st.floats()
)
IDS = st.one_of(st.integers(0, 10), st.sampled_from([LIGHT, 2**32 - 1, -1, 2**40, "hero", "nobody"]))
LETTERS = st.sampled_from("hvwtoax")
KIND_NAMES = st.sampled_from([*KINDS, *(kind.option for kind in KINDS.values()), "all", "parking"])


def options(**ranges: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    """Return some of the options, each over its whole range."""
    return st.fixed_dictionaries({}, optional=ranges)


SPAN: Final = {"start": TIMES, "stop": TIMES}
SUBJECTS = st.one_of(st.sampled_from(["hero", "all", "none"]), st.lists(IDS, max_size=3))
QUERIES: Final[Mapping[str, tuple[Callable[..., Any], st.SearchStrategy[dict[str, Any]]]]] = {
    "info": (lambda recording, **given: info(recording.reader, **given), options(all=st.booleans(), compat=st.booleans())),
    "overview": (lambda recording: (recording.info, recording.summary, recording.sensors, recording.heroes), options()),
    "actors": (lambda recording: (recording.actors, actors(recording.reader)), options()),
    "frames": (Recording.frames, options(**SPAN)),
    "frame_at": (Recording.frame_at, st.fixed_dictionaries({"elapsed": TIMES})),
    "batches": (
        lambda recording, **given: [frame for batch in recording.batches(**given) for frame in batch],
        options(
            types=st.lists(st.sampled_from([*(type.name for type in UE4 if type.id > 1), "weather"]), max_size=3), **SPAN
        ),
    ),
    "table": (Recording.table, st.fixed_dictionaries({"name": st.sampled_from([*(type.name for type in UE4), "none"])})),
    "trajectory": (
        Recording.trajectory,
        st.fixed_dictionaries({"actor_id": IDS, "axes": st.sampled_from(["right-handed", "carla", "left"])}),
    ),
    "trajectories": (
        Recording.trajectories,
        options(
            kind=st.sampled_from(["vehicle", "walker", "other", "plane"]), axes=st.sampled_from(["right-handed", "carla"])
        ),
    ),
    "controls": (Recording.controls, st.fixed_dictionaries({"actor_id": IDS})),
    "light_states": (Recording.light_states, st.fixed_dictionaries({"actor_id": IDS})),
    "sensor_messages": (Recording.sensor_messages, st.fixed_dictionaries({"id": st.text(max_size=3)}, optional=SPAN)),
    "collisions": (Recording.collisions, options(type1=LETTERS, type2=LETTERS, compat=st.booleans())),
    "blocked": (Recording.blocked, options(min_time=LIMITS, min_distance=LIMITS, compat=st.booleans())),
    "incidents": (
        Recording.incidents,
        options(
            kinds=st.one_of(st.none(), KIND_NAMES, st.lists(KIND_NAMES, max_size=3)),
            roads=st.builds(lambda: build_network(STRAIGHT_ROAD, "Straight")),
            min_time=LIMITS,
            min_distance=LIMITS,
            deceleration=LIMITS,
            time_to_collision=LIMITS,
            post_encroachment_time=LIMITS,
            required_deceleration=LIMITS,
            actor=IDS,
            **SPAN,
        ),
    ),
    "diff": (Recording.diff, options(tolerance=LIMITS, time_tolerance=LIMITS, events=st.booleans())),
    "measures": (
        Recording.measures,
        options(actors=SUBJECTS, roads=st.builds(lambda: build_network(STRAIGHT_ROAD, "Straight")), **SPAN),
    ),
    "time_series": (Recording.time_series, st.fixed_dictionaries({"actor_id": IDS}, optional={"other_id": IDS, **SPAN})),
    "measures_over_time": (
        lambda recording, **given: measures_over_time(recording.reader, **given),
        options(actors=SUBJECTS, pair=st.tuples(IDS, IDS)),
    ),
}


def plain(value: Any) -> Any:
    """Return the rows, the columns and the texts of an answer, as what is equal if the answers are; NaN is equal to NaN."""
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return [plain(each) for each in value]
    if isinstance(value, Iterator):
        return [repr(each) for each in value]
    found = []
    if type(value).__name__ == "Differences":
        found += [*differences.text(value), *differences.json(value)]
    elif hasattr(value, "header") and hasattr(value, "extent"):
        found += [*text.text(value), *json.json(value)]
    if isinstance(value, Tabular):
        for column, values in value.columns().items():
            found += [column, (values.dtype, values.tolist()) if isinstance(values, np.ndarray) else repr(values)]
    if isinstance(value, Mapping):
        found += [(key, repr(each)) for key, each in value.items()]
    elif isinstance(value, Rows) or hasattr(value, "row_type"):
        found += map(repr, value)
    return found or repr(value)


def answer(query: Callable[..., Any], recording: Recording, given: dict[str, Any]) -> Any:
    """Return the answer to a query and its warnings, or its error, without the location of the file and offsets in it."""

    def nowhere(value: object) -> str:
        return re.sub(r": byte \d+:", ":", str(value).replace(recording.location, ""))

    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            found = nowhere(plain(query(recording, **given)))
        except FormatError:
            found = "a contradiction"
        except RecapError as error:
            found = type(error), nowhere(error)
    return found, sorted({nowhere(each.message) for each in warned})


@pytest.mark.parametrize("name", QUERIES)
@settings(max_examples=EXAMPLES, phases=PHASES)
@given(data=st.data())
def test_answers_are_equal(name: str, data: st.DataObject, tmp_path: Path) -> None:
    query, ranges = QUERIES[name]
    log, mcap = tmp_path / "a.log", tmp_path / "a.mcap"
    if data.draw(st.booleans()):
        traffic(log, data.draw(st.integers(0, 2**32 - 1)))
    else:
        write(log, *data.draw(recordings()))
    with warnings_ignored():
        convert(log, mcap, force=True)
    given_options = data.draw(ranges)
    other = traffic(tmp_path / "b.log", data.draw(st.integers(0, 2**32 - 1)) if name == "diff" else 0)
    with open_recording(log) as a, open_recording(mcap) as b, open_recording(other) as c:
        given_options |= {"other": c} if name == "diff" else {}
        first, second = (answer(query, recording, given_options) for recording in (a, b))
    assert first == second


def test_bytes_behind_no_spawns_are_warned_of_in_both(tmp_path: Path) -> None:
    frames = [Frame(0, 1, 0.0, 1.0, []), Frame(1, 2, 1.0, 1.0, [Packet(2, UE4[2], b"\0\0\7")])]
    write(tmp_path / "a.log", Header("Nowhere", 0), frames)
    with warnings_ignored():
        convert(tmp_path / "a.log", tmp_path / "a.mcap")
    with open_recording(tmp_path / "a.log") as a, open_recording(tmp_path / "a.mcap") as b:
        first, second = (answer(lambda recording: recording.blocked(), each, {}) for each in (a, b))
    assert first == second
    assert first[1] == [": spawned has 1 bytes more than its records need; they are kept as they are"]
