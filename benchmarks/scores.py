"""The score of a drive along a route, as CARLA's Leaderboard scores it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import carla_recap
from benchmarks.hour import DIRECTORY
from benchmarks.measuring import Line, Subject, at_most, line, memory_line, recap

if TYPE_CHECKING:
    from collections.abc import Iterator

SECONDS: Final = 300
ACTORS: Final = 100
SPACING: Final = 400  # frames between two positions of the route


def scores(_: Subject) -> Iterator[Line]:
    """A drive on autopilot among background traffic, by a route along its way; the processor time of the command."""
    log, route = DIRECTORY / "scored.log", DIRECTORY / "scored.xml"
    traffic = ("--vehicles", ACTORS - 1, "--walkers", 0, "--hero", "--seed", 3, "--duration", SECONDS)
    recap("record", "--force", "-q", log, *traffic)
    with carla_recap.open_recording(log) as recording:
        way = recording.trajectory("hero", axes="carla")
    rows = zip(way.x[::SPACING].tolist(), way.y[::SPACING].tolist(), strict=True)
    positions = "".join(f'<position x="{x:.1f}" y="{y:.1f}" z="0.0"/>' for x, y in rows)
    route.write_text(f'<routes><route id="0" town="Brickfield"><waypoints>{positions}</waypoints></route></routes>')
    carla_recap.convert(log, log.with_suffix(".mcap"), force=True)
    for suffix in (".log", ".mcap"):
        what = f"score of {SECONDS} s with {ACTORS} actors, {suffix}"
        taken = recap("score", log.with_suffix(suffix), "--route", route, "--json", times=3)
        yield line(what, at_most(taken.cpu, "{:.2f} s", 1))
        yield memory_line(what, taken.peak, 200)


ROWS: Final = (scores,)
