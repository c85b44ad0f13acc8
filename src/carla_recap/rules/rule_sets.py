"""Rules for recordings, from a TOML file: what is demanded of each, and the verdicts.

rules = load_rules("rules.toml")
with open_recording("run.mcap") as recording:
    for verdict in check(recording, rules):
        print(verdict.rule, verdict.status, verdict.message)
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final, get_args

from carla_recap.errors import NotSetUp, RecapError
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.measures import SHORT_NAMES
from carla_recap.queries.verdicts import Status as Status
from carla_recap.queries.verdicts import Verdict as Verdict
from carla_recap.rules.facts import Facts, Offence
from carla_recap.rules.reading import Reading, hint, shown
from carla_recap.rules.table import CONDITIONS, PLACE
from carla_recap.tables.trajectories import Axes
from carla_recap.util.files import read_document, reason_of
from carla_recap.util.text import single_line, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from carla_recap.recording import Recording
    from carla_recap.rules.facts import Condition
    from carla_recap.rules.places import Place

_LARGEST: Final = 1 << 16  # bytes of a file of rules: long keys take quadratic time
_MOST_DOTS: Final = 256  # dots in a line of it: a key of many names takes quadratic memory
_MOST_FAULTS: Final = 100  # faults that are listed
_KEYS: Final = ("axes", "places", "rules")
_LISTED: Final = 20  # offences that a verdict lists
_TOLD: Final = re.compile(r" at \d+\.\d\d s\b")
"""The time in the text of an offence, such as that of the least time to collision; the message then has no other one."""


class RulesError(RecapError):
    """Rules are wrong; the message has a line for each fault."""

    def __init__(self, faults: Sequence[str]) -> None:
        super().__init__(faults)
        self.faults = tuple(faults)

    def __str__(self) -> str:
        return "\n".join(self.faults)


@dataclass(frozen=True, slots=True)
class Rule:
    """What is demanded of a recording.

    Attributes:
        name: The name.
        condition: The condition.
        description: The rule in the author's words; else in those of the condition.
        kind: The name of the condition in the file, such as `collisions`.
    """

    name: str
    condition: Condition
    description: str
    kind: str


@dataclass(frozen=True, slots=True)
class RuleSet(Sequence[Rule]):
    """Rules, in the order of their file.

    Attributes:
        path: The path of the file.
        rules: The rules.
    """

    path: str
    rules: tuple[Rule, ...]

    def __len__(self) -> int:
        return len(self.rules)

    def __getitem__(self, index: Any) -> Any:
        return self.rules[index]


def load_rules(path: Path | str) -> RuleSet:
    """Return the rules of a TOML file.

    Raises:
        RulesError: The file is wrong, or a baseline is not there.
        RecapError: It cannot be read.
    """
    return parse_rules(read_document(path, _LARGEST, "a file of rules"), path)


def parse_rules(text: str, path: Path | str) -> RuleSet:
    """Return the rules of a text in TOML, with baselines relative to its path's folder; a `RulesError` if it is wrong."""
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > _MOST_DOTS:
            raise RulesError([f"{path}: line {number}: expected keys of a few names, found {line.count('.')} dots"])
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RulesError([f"{path}: expected TOML: {visible(str(error))}"]) from None
    except RecursionError:
        raise RulesError([f"{path}: expected tables of rules, found too many in one another"]) from None
    except ValueError:  # of `int`
        fault = f"{path}: expected quantities and numbers of things, found a number of thousands of digits"
        raise RulesError([fault]) from None
    reading = Reading(str(path), folder=os.path.dirname(path))  # noqa: PTH120
    unknown = [key for key in document if key not in _KEYS]
    reading.faults.extend(f"{path}: unknown key {shown(key)}; {hint(key, _KEYS, 'keys')}" for key in unknown)
    reading = _with_places(reading, document.get("axes", reading.axes), document.get("places", {}))
    found = document.get("rules")
    if isinstance(found, dict) and found:
        return _rules(found, reading)
    raise RulesError(reading.faults or [f"{path}: expected a table of the form [rules.NAME], found no rules"])


def make_rules(*, axes: Axes = "right-handed", places: Mapping[str, Any] | None = None, **conditions: Any) -> RuleSet:
    """Return rules from Python: a rule for each condition, with its name.

    Args:
        axes: The axes of places, as in a file.
        places: The places that have a name, as in a file.
        conditions: The conditions as in a file, such as `collisions={"of": "hero", "max": 0}`.

    Raises:
        RulesError: A condition is wrong.
    """
    rules = _rules(
        {name: {name: value} for name, value in conditions.items()}, _with_places(Reading("rules"), axes, places or {})
    )
    return replace(rules, path="")


def check(recording: Recording, rules: Iterable[Rule], *, road_map: str | None = None) -> list[Verdict]:
    """Return the verdicts of rules on a recording, in the order of the rules; only what they need is read.

    A recording that is damaged gives verdicts with the status `error`.

    Args:
        recording: The recording.
        rules: The rules.
        road_map: The map, or the folder of maps, for rules about the road; None: the usual folders.
    """
    rules = list(rules)
    facts = Facts(recording, (rule.condition.needs() for rule in rules), road_map)
    return [_verdict(rule, facts) for rule in rules]


def _verdict(rule: Rule, facts: Facts) -> Verdict:
    began = perf_counter()
    verdict = _judged(rule, facts)
    return replace(verdict, seconds=perf_counter() - began)


def _judged(rule: Rule, facts: Facts) -> Verdict:
    try:
        if rule.condition.needs().roads:
            facts.roads_with(None)
        passes, message, offences, applies = rule.condition.judge(facts)
    except NotSetUp:
        raise
    except RecapError as error:
        return Verdict(rule.name, "error", visible(str(error).removeprefix(f"{facts.recording.location}: ")))
    except OSError as error:
        return Verdict(rule.name, "error", visible(reason_of(error)))
    if passes:
        return Verdict(rule.name, "pass", visible(message if applies else f"nothing to judge: {message}"), applies=applies)
    offences = tuple(each if math.isfinite(each.time or 0.0) else each._replace(time=None) for each in offences)
    details = [each.text if each.time is None else f"{each.time:.2f} s: {each.text}" for each in offences[:_LISTED]]
    if len(offences) > _LISTED:
        details.append(f"and {len(offences) - _LISTED} more")
    _, time, actors = offences[0] if offences else Offence("")
    if offences:
        is_told = time is None or _TOLD.search(offences[0].text)
        message += f": {offences[0].text}" + ("" if is_told else f" at {time:.2f} s")
    return Verdict(rule.name, "fail", visible(message), time, actors, tuple(map(visible, details)))


def _with_places(reading: Reading, axes: Any, places: Any) -> Reading:
    """Return what reads rules with axes and with places that have names; add their faults."""
    path = reading.prefix
    if axes not in get_args(Axes):
        reading.of(f"{path}: axes").refuse(axes, f"one of {', '.join(get_args(Axes))}")
    else:
        reading = replace(reading, axes=axes)
    if not isinstance(places, dict):
        reading.of(f"{path}: places").refuse(places, "tables of the form [places.NAME]")
        return reading
    found: dict[str, Place | None] = {}
    for name, table in places.items():
        of_it = reading.of(f"{path}: place {shown(name)}")
        if not name.strip() or name in KINDS or any(name == kind.option for kind in KINDS.values()):
            of_it.refuse(name, "a name that is no kind of incidents")
        elif not isinstance(table, dict):
            of_it.refuse(table, "a table, as [places.NAME]")
        else:
            place = of_it.value(PLACE, table)
            found[name] = None if place is None else replace(place, name=name)
    return replace(reading, places=found)


def _rules(tables: Mapping[str, Any], reading: Reading) -> RuleSet:
    """Return rules, or raise the faults of all of them."""
    path, faults = reading.prefix, reading.faults
    rules = [_rule(name, table, reading.of(f"{path}: rule {shown(name)}")) for name, table in tables.items()]
    if faults:
        more = [f"{path}: and {len(faults) - _MOST_FAULTS} more faults"] if len(faults) > _MOST_FAULTS else []
        raise RulesError([*faults[:_MOST_FAULTS], *more])
    return RuleSet(path, tuple(rule for rule in rules if rule is not None))


def _rule(name: str, table: Any, reading: Reading) -> Rule | None:
    """Return a rule; None if it has faults."""
    prefix, faults = reading.prefix, reading.faults
    count = len(faults)
    if not name.strip():
        faults.append(f"{prefix}: expected a name")
    if not isinstance(table, dict):
        reading.refuse(table, "a table, as [rules.NAME]")
        return None
    description = table.get("description")
    if description is not None and not isinstance(description, str):
        reading.of(f"{prefix}: description").refuse(description, "a text")
    given = {key: value for key, value in table.items() if key != "description"}
    kinds = {key: kind for key in given if (kind := CONDITIONS.get(SHORT_NAMES.get(key, key))) is not None}
    unknown = [key for key in given if key not in kinds]
    faults += [f"{prefix}: unknown condition {shown(key)}; {hint(key, list(CONDITIONS), 'conditions')}" for key in unknown]
    if len(kinds) != 1 and not unknown:
        one = "one condition" if kinds else f"one of the conditions {', '.join(CONDITIONS)}"
        faults.append(f"{prefix}: expected {one}, found {' and '.join(kinds) or 'none'}")
    found = [kind.read(given[key], reading.of(f"{prefix}: {key}")) for key, kind in kinds.items()]
    if len(faults) > count or found[0] is None:
        return None
    (kind,) = kinds.values()
    return Rule(name, found[0], single_line(description or str(found[0])), kind.name)
