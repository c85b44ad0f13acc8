"""Answers as the text that CARLA's query functions print."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.frame import Packet
from carla_recap.model.records import FRAME_END
from carla_recap.util.text import first_of, number, readable, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from carla_recap.model.frame import Frame
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.blocked import Blocked, BlockedRow
    from carla_recap.queries.collisions import CollisionRow, Collisions
    from carla_recap.queries.incidents import Incident, Incidents
    from carla_recap.queries.info import Info
    from carla_recap.queries.measures import Measures
    from carla_recap.queries.measures.definitions import MeasureRow
    from carla_recap.queries.measures.series import MeasuresOverTime
    from carla_recap.queries.recorded_actors import RecordedActors
    from carla_recap.queries.summary import HeroSummary, RecordingSummary, Summaries

    AnyAnswer = RecordedActors | Info | Collisions | Blocked | Incidents | Measures | MeasuresOverTime | Summaries

_NAME_WIDTH: Final = 35
_SENSORS: Final = 20  # of a recording, that its summary names
KMH: Final = 3.6
"""km/h in a m/s."""


def text(answer: AnyAnswer) -> Iterator[str]:
    """Yield CARLA's text of an answer, in pieces; a similar list of what CARLA has no text for."""
    kind = type(answer).__name__
    header = answer.header
    yield f"Version: {header.version}\nMap: {readable(header.map_name)}\nDate: {local_date(header.date)}\n\n"
    if kind in _ALONE:
        yield from _ALONE[kind](answer)
    else:
        yield heading(kind)
        yield from lines(answer)
    # In CARLA, the row of a collision sets the number format of the stream to no decimals.
    rounded = answer.compat and kind == "Collisions" and any(answer)
    duration = (_whole if rounded else number)(answer.extent.duration)
    yield f"\nFrames: {answer.extent.last_id}\nDuration: {duration} seconds\n"


def lines(answer: AnyAnswer) -> Iterator[str]:
    """Yield the lines of an answer that are for one of many recordings: those of its rows; for info, all of its text."""
    kind = type(answer).__name__
    if kind not in _LISTS:
        yield from text(answer)
        return
    _, line = _LISTS[kind]
    for row in answer:
        yield f"{line(row)}\n"


def heading(kind: str) -> str:
    """Return the line above the rows of a kind of answers, by the name of its class; empty for info."""
    return f"{_LISTS[kind][0]}\n" if kind in _LISTS else ""


def local_date(seconds: int) -> str:
    """Return a date in local time, as in the C locale; the number itself if it is out of range."""
    try:
        return time.strftime("%m/%d/%y %H:%M:%S", time.localtime(seconds))
    except (OverflowError, ValueError, OSError):
        return str(seconds)


def _whole(value: float) -> str:
    """Return a number rounded to no decimals, half to even."""
    return "-nan" if number(value) == "-nan" else f"{value:.0f}"


def _padded(name: str) -> str:
    """Return a name padded to the width of a column, which CARLA counts in bytes."""
    return name + " " * (_NAME_WIDTH - len(name.encode()))


def _collision(row: CollisionRow) -> str:
    types = f"  {row.letter1} {row.letter2} "
    return f"{_whole(row.elapsed):>8} {types} {row.id1:>6} {_padded(row.type_id1)} {row.id2:>6} {_padded(row.type_id2)}"


def _blocked(row: BlockedRow) -> str:
    return f"{_whole(row.start):>8} {row.id:>6} {_padded(row.type_id)} {_whole(row.duration):>10}"


def _incident(row: Incident) -> str:
    return f"{row.start:>8.2f} {row.stop - row.start:>10.2f} {row.kind:<12} {row.text}"


def _measure(row: MeasureRow) -> str:
    other = "" if row.other is None else row.other
    value = f"{row.measure:<22} {row.value:>10.3f} {row.unit:<5}"
    return f"{row.time:>8.2f} {row.actor:>6} {_padded(row.type_id)} {value} {other:>6} {row.other_type_id}".rstrip()


def _moment(row: Any) -> str:
    values = (row.speed, row.acceleration, row.gap, row.time_to_collision, row.distance_headway, row.time_headway)
    others = ("" if id is None else id for id in (row.nearest, row.threat, row.leader))
    numbers = " ".join(f"{value:>8.2f}" if math.isfinite(value) else " " * 8 for value in values)
    return f"{row.time:>8.2f} {row.actor:>6} {numbers} {' '.join(f'{id:>7}' for id in others)}".rstrip()


def _actor(row: ActorLife) -> str:
    until = "" if row.destroyed_at is None else number(row.destroyed_at)
    parent = "" if row.parent is None else row.parent
    name = f"{_padded(row.type_id)} {row.role_name:<20}"
    return f"{row.id:>8} {row.kind:<13} {name} {number(row.spawned_at):>8} {until:>8} {parent:>8}"


def _summary(row: RecordingSummary) -> str:
    vehicles, walkers = row.actors.get("vehicle", 0), row.actors.get("walker", 0)
    others = sum(row.actors.values()) - vehicles - walkers
    way = f"{row.hero.distance:>8.0f} {top_speed(row.hero):>5}" if row.hero else f"{'':>14}"
    numbers = f"{number(row.duration):>8} {row.frames:>8} {vehicles:>8} {walkers:>7} {others:>6}"
    return f"{numbers} {way} {readable(row.map):<12} {incident_counts(row.incidents)}"


def top_speed(hero: HeroSummary) -> str:
    """Return the top speed of a hero in km/h; empty if it is unknown."""
    return "" if math.isnan(hero.top_speed) else f"{hero.top_speed * KMH:.0f}"


def _overview(answer: Summaries) -> Iterator[str]:
    for row in answer:
        yield f"Actors: {_counted(row.actors, answer.others)}\n"
        if row.hero is not None:
            hero = row.hero
            speed = f"{top} km/h at most" if (top := top_speed(hero)) else "an unknown speed"
            way = f"{hero.distance:.0f} m in {hero.time:.1f} s, at {speed}"
            yield f"Hero: {hero.type_id} ({hero.id}), {way}\n"
        yield f"Incidents: {incident_counts(row.incidents)}\n"
        if row.sensors:
            named = [f"{visible(id)} ({visible(type)})" for id, type in row.sensors.items()]
            yield f"Sensor data: {first_of(named, _SENSORS)}\n"


def _counted(actors: Mapping[str, int], others: Mapping[str, int]) -> str:
    """Return the numbers of actors by kind in words; of others, that of the blueprint that most of them have, too."""
    words = {kind: f"{count} {kind.replace('_', ' ')}{'s' * (count != 1)}" for kind, count in actors.items()}
    name, most = next(iter(others.items()), ("", 0))
    if most > 1 and 2 * most > actors["other"]:
        words["other"] += f" ({most} {visible(name)})"
    return ", ".join(words.values()) or "none"


def incident_counts(incidents: Mapping[str, int]) -> str:
    """Return the numbers of incidents by kind in words."""
    from carla_recap.queries.kinds import KINDS

    words = (f"{count} {KINDS[kind].singular if count == 1 else KINDS[kind].plural}" for kind, count in incidents.items())
    return ", ".join(words) or "none"


def _info(answer: Info) -> Iterator[str]:
    from carla_recap.output.packet_lines import packet_lines
    from carla_recap.queries.info import EVENTS

    lines = packet_lines(compat=answer.compat)
    frame = None
    for frame in answer.frames():
        parts = []
        headed = answer.all and not frame.preamble
        if headed:
            parts.append(_frame_line(frame.id, frame.elapsed))
        for packet in frame.packets:
            if packet.type is None or packet.type.name not in lines:
                continue
            if not headed and packet.type.name in EVENTS and len(packet.records):
                parts.append(_frame_line(frame.id, frame.elapsed))
                headed = True
            parts.append(lines[packet.type.name](packet))
        yield "".join(parts)
    if answer.compat:
        yield _repeated_end(answer, frame)


_ALONE: Final[Mapping[str, Callable[[Any], Iterator[str]]]] = {"Info": _info, "Summaries": _overview}
"""The texts of answers about one recording that are no lists."""
_LISTS: Final[Mapping[str, tuple[str, Callable[[Any], str]]]] = {
    "Collisions": (f"{'Time':>8} {'Types':>6} {'Id':>6} {'Actor 1':<35} {'Id':>6} {'Actor 2':<35}", _collision),
    "Blocked": (f"{'Time':>8} {'Id':>6} {'Actor':<35} {'Duration':>10}", _blocked),
    "Incidents": (f"{'Time':>8} {'Duration':>10} {'Incident':<12} What happens", _incident),
    "Measures": (f"{'Time':>8} {'Id':>6} {'Actor':<35} {'Measure':<22} {'Value':>10} {'Unit':<5} {'Id':>6} Other", _measure),
    "MeasuresOverTime": (
        f"{'Time':>8} {'Id':>6} {'m/s':>8} {'m/s²':>8} {'Gap (m)':>8} {'TTC (s)':>8} {'Ahead m':>8} {'Ahead s':>8}"
        f" {'Nearest':>7} {'Threat':>7} {'Leader':>7}",
        _moment,
    ),
    "RecordedActors": (f"{'Id':>8} {'Kind':<13} {'Actor':<35} {'Role':<20} {'From':>8} {'To':>8} {'Parent':>8}", _actor),
    "Summaries": (
        f"{'Duration':>8} {'Frames':>8} {'Vehicles':>8} {'Walkers':>7} {'Others':>6} {'Hero (m)':>8} {'km/h':>5}"
        f" {'Map':<12} Incidents",
        _summary,
    ),
}
"""The line above the rows, and the line of a row, by the name of the answer's class: no other queries are imported."""


def _frame_line(id: int, elapsed: float) -> str:
    return f"Frame {id} at {number(elapsed)} seconds\n"


def _repeated_end(answer: Info, last: Frame | None) -> str:
    """Return what CARLA prints in addition at the end of a file whose last packet is not the end of a frame.

    CARLA processes the last packet once more, with its last record repeated; in a file without packets, the start of a
    frame 0. For a file that was cut short, this cannot be reproduced, and nothing is returned.
    """
    from carla_recap.output.packet_lines import packet_lines
    from carla_recap.queries.info import EVENTS

    source, extent = answer.source, answer.extent
    if next(source.tail(), None) is not None:
        return ""
    if last is None:
        return _frame_line(0, 0.0) if answer.all and not extent.frames else ""
    if not answer.all:
        if (last.id, last.elapsed) != (extent.last_id, extent.duration):
            return ""
        last = source.frame_at(math.inf) or last
    was_cut = not last.preamble and all(packet.id != FRAME_END for packet in last.packets)
    packet = last.packets[-1] if last.packets else None
    if was_cut or packet is None or packet.type is None or not isinstance(packet.records, np.ndarray):
        return ""
    lines = packet_lines(compat=True).get(packet.type.name)
    if lines is None or not (answer.all or packet.type.name in EVENTS):
        return ""
    again = np.repeat(packet.records[-1:], len(packet.records))
    return lines(Packet(packet.id, packet.type, records=again))
