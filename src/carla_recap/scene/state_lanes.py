"""Lanes of a timeline of states: to whom incidents of a kind happen, and from when on a recording breaks a rule."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.kinds import KINDS
from carla_recap.scene import style

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from carla_recap.queries.incidents import Incident
    from carla_recap.queries.kinds import IncidentKind
    from carla_recap.queries.verdicts import Verdict
    from carla_recap.scene.materials import Color
    from carla_recap.util.arrays import Floats

NONE: Final = "none"
"""The state of a lane while nothing happens."""
NO_COLOR: Final[Color] = (38, 42, 50)

_PASS: Final = "pass"
_COLORS: Final[dict[str, Color]] = {"fail": style.COLLISION, "error": (205, 150, 240)}
_PASS_COLOR: Final[Color] = (50, 160, 90)


class StateLane(NamedTuple):
    """What a timeline shows of incidents of a kind, or of a rule."""

    name: str  # such as `near-miss`, or the name of the rule
    states: Sequence[tuple[int, str]]  # the scene from which on each state holds, the first one from scene 0 on
    color: Color  # of all states but the one in which nothing happens
    calm: tuple[str, Color]  # that state, and its color


def incident_lanes(found: Iterable[Incident], elapsed: Floats) -> list[StateLane]:
    """Return a lane for each kind of incidents that happen during some scenes, the most important kind first.

    `elapsed` are the moments of all scenes, at least one, in elapsed seconds.
    """
    seconds = np.maximum.accumulate(elapsed)
    changes: dict[str, dict[int, Counter[int]]] = {kind: defaultdict(Counter) for kind in KINDS}
    for each in found:
        first = int(np.searchsorted(seconds, each.start - SAME_TIME))
        stop = max(first + 1, int(np.searchsorted(seconds, each.stop + SAME_TIME, "right")))
        if first < len(seconds) and (first or each.stop >= seconds[0] - SAME_TIME):
            changes[each.kind][first].update(each.actors)
            changes[each.kind][stop].subtract(each.actors)
    return [_incident_lane(kind, changes[kind.name], len(seconds)) for kind in KINDS.values() if changes[kind.name]]


def _incident_lane(kind: IncidentKind, changes: dict[int, Counter[int]], count: int) -> StateLane:
    """Return the lane of a kind, given how often an incident of each actor begins, less how often one ends, by scene."""
    states, now = ([] if 0 in changes else [(0, NONE)]), Counter[int]()
    for row in sorted(row for row in changes if row < count):
        now.update(changes[row])
        actors = sorted(actor for actor, number in now.items() if number)
        states.append((row, f"{kind.singular}: {', '.join(map(str, actors))}" if actors else NONE))
    red, green, blue = bytes.fromhex(kind.dark[1:])
    return StateLane(kind.option, states, (red, green, blue), (NONE, NO_COLOR))


def verdict_lanes(verdicts: Iterable[Verdict], elapsed: Floats) -> list[StateLane]:
    """Return a lane for each verdict: `pass` until the rule is broken, then what breaks it; see `incident_lanes`."""
    seconds = np.maximum.accumulate(elapsed)
    lanes = []
    for verdict in verdicts:
        row = 0 if verdict.time is None else int(np.searchsorted(seconds, verdict.time - SAME_TIME))
        states = [(0, _PASS)] if row or verdict.status == "pass" else []
        if verdict.status != "pass" and row < len(seconds):
            states.append((row, f"{verdict.status}: {verdict.message}"))
        lanes.append(StateLane(verdict.rule, states, _COLORS.get(verdict.status, _PASS_COLOR), (_PASS, _PASS_COLOR)))
    return lanes
