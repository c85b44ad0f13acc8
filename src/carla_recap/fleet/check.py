"""The check of many recordings by rules: a verdict per recording and rule, and what it takes to see why one fails."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError
from carla_recap.fleet.engine import map_sources
from carla_recap.recording import open_recording
from carla_recap.roads.find import plain_name
from carla_recap.rules.rule_sets import RuleSet, Status, Verdict, check
from carla_recap.util.text import readable, visible

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable
    from typing import Unpack

    from carla_recap.fleet.engine import Processes
    from carla_recap.fleet.outcomes import Outcome
    from carla_recap.fleet.sources import SourceFile

WORST_FIRST: Final[tuple[Status, ...]] = ("error", "fail", "pass")


@dataclass(frozen=True, slots=True)
class CheckedRecording:
    """A recording and the verdicts on it."""

    recording: str  # its path or URL
    verdicts: tuple[Verdict, ...]  # in the order of the rules
    map: str = ""  # the name of its map; empty if it cannot be opened
    frames: int = 0  # the number of its frames
    duration: float = 0.0  # in s
    warnings: tuple[str, ...] = ()  # a line each
    page: str | None = None  # the path of its incident page, relative to the folder of pages until `in_folder`
    clip: str | None = None  # the path of the clip of the first failure, likewise
    sensors: tuple[str, ...] = ()  # the ids of the sensors whose data it has
    status: Status = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "status", worst(verdict.status for verdict in self.verdicts))

    def in_folder(self, pages: Path | str) -> CheckedRecording:
        """Return it with the paths of its page and clip in the folder of pages."""
        page, clip = (path and Path(pages, path).as_posix() for path in (self.page, self.clip))
        return replace(self, page=page, clip=clip)

    @property
    def idle(self) -> list[Verdict]:
        """The verdicts of rules that are met as there was nothing to judge."""
        return [verdict for verdict in self.verdicts if verdict.status == "pass" and not verdict.applies]


def worst(statuses: Iterable[Status]) -> Status:
    """Return the worst of some statuses; without any, `pass`."""
    return min(statuses, key=WORST_FIRST.index, default="pass")


def strict(checked: CheckedRecording) -> CheckedRecording:
    """Return a recording whose rules that had nothing to judge are broken instead of met."""
    return replace(
        checked,
        verdicts=tuple(
            replace(each, status="fail") if each.status == "pass" and not each.applies else each for each in checked.verdicts
        ),
    )


def check_sources(
    sources: Iterable[SourceFile], rules: RuleSet, *, road_map: str | None = None, **processes: Unpack[Processes]
) -> Generator[CheckedRecording]:
    """Yield many recordings with the verdicts on them, in their order; see `carla_recap.rules.rule_sets.check`."""
    for outcome in map_sources(partial(_checked, rules, road_map), sources, **processes):
        if outcome.value is None:
            yield unread(outcome, [rule.name for rule in rules])
        else:
            yield replace(outcome.value, warnings=tuple(map(visible, outcome.warnings)))


def unread(outcome: Outcome[Any], rules: Iterable[str]) -> CheckedRecording:
    """Return a recording that cannot be read, with its error as the verdict of each rule."""
    error = visible((outcome.error or "it cannot be read").removeprefix(f"{outcome.source.location}: "))
    verdicts = tuple(Verdict(rule, "error", error) for rule in rules)
    return CheckedRecording(outcome.source.location, verdicts, warnings=outcome.warnings)


def _checked(rules: RuleSet, road_map: str | None, source: SourceFile) -> CheckedRecording:
    with open_recording(source.address) as recording:
        verdicts = check(recording, rules, road_map=road_map)
        map_name = visible(plain_name(readable(recording.header.map_name)))
        found = CheckedRecording(source.location, tuple(verdicts), map_name)
        try:
            extent = recording.reader.extent()
            names = tuple(visible(sensor.id) for sensor in recording.sensors)
        except RecapError:  # which the verdicts say
            return found
        duration = extent.duration if math.isfinite(extent.duration) else 0.0
        return replace(found, frames=extent.frames, duration=duration, sensors=names)
