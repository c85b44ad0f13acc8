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
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final, Literal

from carla_recap.errors import RecapError
from carla_recap.fleet import conditions
from carla_recap.fleet.conditions import ANY, OBJECT, ROLE, Bounds, Facts, Offence, Quantity, Selector
from carla_recap.model.actors import HERO
from carla_recap.queries.kinds import KINDS, kind_named
from carla_recap.queries.measures import MEASURES
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from carla_recap.fleet.conditions import Condition
    from carla_recap.recording import Recording

Status = Literal["pass", "fail", "error"]

_LARGEST: Final = 1 << 16  # bytes of a file of rules: long keys take quadratic time
_MOST_DOTS: Final = 256  # dots in a line of it: a key of many names takes quadratic memory
_MOST_FAULTS: Final = 100  # faults that are listed
_LARGEST_COUNT: Final = 1 << 63
_SHOWN: Final = 60  # characters of a wrong value in an error
_LISTED: Final = 20  # offences that a verdict lists
_TOLD: Final = re.compile(r" at \d+\.\d\d s\b")
"""The time in the text of an offence, such as that of the least time to collision; the message then has no other one."""
_UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0},
    "m/s": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704},
    "m/s²": {"m/s²": 1.0, "m/s^2": 1.0, "m/s2": 1.0, "g": 9.80665},
    "m/s³": {"m/s³": 1.0, "m/s^3": 1.0, "m/s3": 1.0},
}
"""The units of quantities, and how many of the first one each of them is."""
_QUANTITY: Final = re.compile(r"\s*([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


class RulesError(RecapError):
    """Rules are wrong; the message has a line for each fault.

    Args:
        faults: The faults; each names the file, the rule and what was expected.
    """

    def __init__(self, faults: Sequence[str]) -> None:
        super().__init__(faults)
        self.faults = tuple(faults)

    def __str__(self) -> str:
        return "\n".join(self.faults)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a rule says of a recording.

    Attributes:
        rule: The name of the rule.
        status: `pass`; `fail`; or `error`, if the recording cannot be judged, as when it is damaged.
        message: What was found, in one line.
        time: When the first or the worst offence happens, in elapsed seconds; None if there is none.
        actors: The ids of its actors.
        details: The offences, a line each.
        seconds: How long it took to judge, in s; what several rules need is read for the first of them.
    """

    rule: str
    status: Status
    message: str
    time: float | None = None
    actors: tuple[int, ...] = ()
    details: tuple[str, ...] = ()
    seconds: float = field(default=0.0, compare=False)


@dataclass(frozen=True, slots=True)
class Rule:
    """What is demanded of a recording.

    Attributes:
        name: The name.
        condition: The condition.
        description: The rule in the author's words; else in those of the condition.
    """

    name: str
    condition: Condition
    description: str


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
    try:
        with Path(path).open("rb") as file:
            content = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        raise RecapError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if len(content) > _LARGEST:
        raise RecapError(f"{path}: is larger than {_LARGEST >> 10} kB; a file of rules was expected")
    try:
        rules = parse_rules(content.decode("utf-8-sig"), path)
    except UnicodeDecodeError as error:
        raise RecapError(f"{path}: byte {error.start}: UTF-8 was expected") from None
    baselines = {rule.name: rule.condition for rule in rules if isinstance(rule.condition, conditions.SameAs)}
    missing = {name: condition.baseline for name, condition in baselines.items() if not condition.exists()}
    if missing:
        text = "{}: rule {!r}: same_as.baseline: there is no {}; a recording, or a folder of recordings, was expected"
        raise RulesError([text.format(path, name, baseline) for name, baseline in missing.items()])
    return rules


def parse_rules(text: str, path: Path | str) -> RuleSet:
    """Return the rules of a text.

    Args:
        text: The content of a TOML file.
        path: Its path, for errors; paths of baselines are relative to its folder.

    Raises:
        RulesError: The text is wrong.
    """
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > _MOST_DOTS:
            raise RulesError([f"{path}: line {number}: has {line.count('.')} dots; keys of a few names were expected"])
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RulesError([f"{path}: {visible(str(error))}; TOML was expected"]) from None
    except RecursionError:
        raise RulesError([f"{path}: is nested too deeply; tables of rules were expected"]) from None
    except ValueError:  # of `int`
        fault = f"{path}: has a number of thousands of digits; quantities and numbers of things were expected"
        raise RulesError([fault]) from None
    tables = "tables of the form [rules.NAME] were expected"
    unknown = [key for key in document if key != "rules"]
    faults = [f"{path}: {_shown(key)}: is unknown; {_hint(key, ['rules'], tables)}" for key in unknown]
    found = document.get("rules")
    if isinstance(found, dict) and found:
        return _rules(found, path, faults)
    raise RulesError(faults or [f"{path}: has no rules; a table of the form [rules.NAME] was expected"])


def make_rules(**conditions: Any) -> RuleSet:
    """Return rules from Python: a rule for each condition, with its name.

    Args:
        conditions: The conditions as in a file, such as `collisions={"of": "hero", "max": 0}`.

    Raises:
        RulesError: A condition is wrong.
    """
    rules = _rules({name: {name: value} for name, value in conditions.items()}, "rules", [])
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
    facts = Facts(recording, (rule.condition for rule in rules), road_map)
    return [_verdict(rule, facts) for rule in rules]


def unreadable(rules: Iterable[Rule], error: str) -> list[Verdict]:
    """Return the verdicts on a recording that cannot be opened."""
    return [Verdict(rule.name, "error", error) for rule in rules]


def _verdict(rule: Rule, facts: Facts) -> Verdict:
    began = perf_counter()
    verdict = _judged(rule, facts)
    return replace(verdict, seconds=perf_counter() - began)


def _judged(rule: Rule, facts: Facts) -> Verdict:
    try:
        passes, message, offences = rule.condition.judge(facts)
    except RecapError as error:
        return Verdict(rule.name, "error", visible(str(error).removeprefix(f"{facts.recording.location}: ")))
    except OSError as error:
        return Verdict(rule.name, "error", visible(error.strerror or str(error)))
    if passes:
        return Verdict(rule.name, "pass", visible(message))
    offences = tuple(each if math.isfinite(each.time or 0.0) else each._replace(time=None) for each in offences)
    details = [each.text if each.time is None else f"{each.time:.2f} s: {each.text}" for each in offences[:_LISTED]]
    if len(offences) > _LISTED:
        details.append(f"and {len(offences) - _LISTED} more")
    _, time, actors = offences[0] if offences else Offence("")
    if offences:
        is_told = time is None or _TOLD.search(offences[0].text)
        message += f": {offences[0].text}" + ("" if is_told else f" at {time:.2f} s")
    return Verdict(rule.name, "fail", visible(message), time, actors, tuple(map(visible, details)))


# --- from TOML -----------------------------------------------------------------------------------------------------------


class _Fields:
    """The fields of a condition: reads those that are expected, and collects the faults of these and others.

    A field that is wrong is read as if it were missing.

    Args:
        table: The fields.
        prefix: The file, the rule and the name of the condition, for faults.
        faults: The faults.
        folder: The folder that paths are relative to.
    """

    def __init__(self, table: Any, prefix: str, faults: list[str], folder: str = "") -> None:
        self._prefix = prefix
        self._faults = faults
        self.folder = folder
        self._table = table if isinstance(table, dict) else {}
        self._known: list[str] = []
        self._is_table = isinstance(table, dict)
        if not self._is_table:
            self._faults.append(f"{prefix}: {_shown(table)}; a table was expected, such as {{ max = 0 }}")

    def get(self, name: str) -> Any:
        """Return the value of a field, or None."""
        self._known.append(name)
        return self._table.get(name)

    def refuse(self, name: str, expected: str) -> None:
        """Add the fault of a value."""
        if self._is_table:
            self._faults.append(f"{self._prefix}.{name}: {_shown(self._table.get(name))}; {expected} was expected")

    def selector(self, name: str, *, is_other: bool = False) -> Selector:
        """Return some actors; any, if the field is missing."""
        value = self.get(name)
        if value is None:
            return Selector()
        words = [HERO, "vehicle", "walker", ANY, *([OBJECT] if is_other else [])]
        is_pattern = isinstance(value, str) and (
            (value.startswith(ROLE) and value != ROLE) or re.fullmatch(r"[\w*?\[\]!-]+(\.[\w*?\[\]!-]+)+", value)
        )
        if value not in words and not is_pattern:
            self.refuse(name, f"{', '.join(words)}, role:NAME or a blueprint such as vehicle.tesla.*")
            return Selector()
        return Selector(value)

    def flag(self, name: str) -> bool:
        """Return whether a field is true."""
        value = self.get(name)
        if value not in (None, True, False):
            self.refuse(name, "true or false")
        return value is True

    def texts(self, name: str, expected: str, read: Callable[[str], str] = str, *, single: bool = False) -> tuple[str, ...]:
        """Return one text, or a list of them; `read` changes each, or raises a `RecapError`."""
        value = self.get(name)
        values = value if isinstance(value, list) and not single else [value]
        with suppress(RecapError):
            if values and all(isinstance(each, str) and each for each in values):
                return tuple(dict.fromkeys(map(read, values)))
        self.refuse(name, expected)
        return ("",)

    def counts(self) -> Bounds:
        """Return the bounds of a number of things, from `min` and `max`."""

        def read(name: str) -> Quantity | None:
            value = self.get(name)
            if value is not None and (type(value) is not int or not 0 <= value <= _LARGEST_COUNT):
                self.refuse(name, "a whole number of 0 or more")
                return None
            return None if value is None else Quantity(value)

        return self._bounds(read)

    def quantities(self, unit: str) -> Bounds:
        """Return the bounds of a quantity, from `min` and `max`."""
        return self._bounds(lambda name: self.quantity(name, unit))

    def quantity(self, name: str, unit: str) -> Quantity | None:
        """Return a quantity: a number in a unit, or a text with a number and its unit; None if the field is missing."""
        value = self.get(name)
        if value is None:
            return None
        units = _UNITS.get(unit, {})
        if type(value) in (int, float) and abs(value) <= 1e300:
            return Quantity(float(value), unit)
        if isinstance(value, str) and len(value) < _SHOWN and (match := _QUANTITY.fullmatch(value)):
            size = units.get(match[2], math.nan)
            if math.isfinite(float(match[1]) * size):
                return Quantity(float(match[1]) * size, match[2], size, f"{match[1]} {match[2]}")
        expected = f'a number in {unit}, or a text such as "1.5 {unit}" with one of the units {", ".join(units)},'
        self.refuse(name, expected if units else "a number")
        return None

    def _bounds(self, read: Callable[[str], Quantity | None]) -> Bounds:
        count = len(self._faults)
        least, most = read("min"), read("max")
        if self._is_table and len(self._faults) == count:
            if least is None and most is None:
                if all(name in self._known for name in self._table):
                    self._faults.append(f"{self._prefix}: has no bound; min or max was expected")
            elif least is not None and most is not None and least.value > most.value:
                self.refuse("min", "no more than max")
        return Bounds(least, most)

    def done(self) -> None:
        """Refuse fields that were not read."""
        for name in self._table:
            if name not in self._known:
                self._faults.append(f"{self._prefix}: unknown field {_shown(name)}; {_hint(name, self._known)}")


def _collisions(fields: _Fields) -> Condition:
    of, other = fields.selector("of"), fields.selector("with", is_other=True)
    at_fault = fields.flag("at_fault")
    return conditions.IncidentCount(("collision",), of, other, fields.counts(), at_fault)


def _incidents(fields: _Fields) -> Condition:
    kinds = fields.texts("kind", f"one or a list of {', '.join(KINDS)}", lambda text: kind_named(text).name)
    return conditions.IncidentCount(kinds, fields.selector("of"), Selector(), fields.counts())


def _blocked(fields: _Fields) -> Condition:
    of, longest = fields.selector("of"), fields.quantity("max", "s")
    if fields.get("max") is None or (longest is not None and longest.value < 0):
        fields.refuse("max", 'the longest valid stop, such as "60 s",')
    return conditions.LongestStop(of, longest or Quantity(0.0, "s"))


def _duration(fields: _Fields) -> Condition:
    return conditions.Size("s", fields.quantities("s"))


def _frames(fields: _Fields) -> Condition:
    return conditions.Size("frames", fields.counts())


def _actors(fields: _Fields) -> Condition:
    return conditions.ActorCount(fields.selector("of"), fields.counts())


def _map(fields: _Fields) -> Condition:
    return conditions.MapName(fields.texts("map", "the name of a map or a list of names"))


def _measure(name: str, fields: _Fields) -> Condition:
    of, bounds = fields.selector("of"), fields.quantities(MEASURES[name].unit)
    extreme = MEASURES[name].extreme
    wrong, right, given = ("max", "min", bounds.most) if extreme == "least" else ("min", "max", bounds.least)
    if given is not None:
        fields.refuse(wrong, f"{right} (since the {extreme} value is measured)")
    return conditions.MeasureBounds(name, of, bounds)


def _same_as(fields: _Fields) -> Condition:
    (baseline,) = fields.texts("baseline", "the path of a recording, or of a folder of recordings,", single=True)
    tolerance = fields.quantity("tolerance", "m") or Quantity(0.0, "m")
    if tolerance.value < 0:
        fields.refuse("tolerance", "a distance of 0 or more")
    path = baseline if "://" in baseline else os.path.join(fields.folder, baseline)  # noqa: PTH118
    return conditions.SameAs(path, tolerance)


_CONDITIONS: Final[Mapping[str, Callable[[_Fields], Condition]]] = {
    "collisions": _collisions,
    "incidents": _incidents,
    "blocked": _blocked,
    "duration": _duration,
    "frames": _frames,
    "actors": _actors,
    "map": _map,
    "same_as": _same_as,
    **{name: partial(_measure, name) for name in MEASURES},
}
"""What reads the fields of each condition."""
_PLAIN: Final = ("map",)
"""The conditions that are one value, and no table."""


def _rules(tables: Mapping[str, Any], path: Path | str, faults: list[str]) -> RuleSet:
    """Return rules, or raise the faults of all of them."""
    rules = [_rule(name, table, path, faults) for name, table in tables.items()]
    if faults:
        more = [f"{path}: and {len(faults) - _MOST_FAULTS} more faults"] if len(faults) > _MOST_FAULTS else []
        raise RulesError([*faults[:_MOST_FAULTS], *more])
    return RuleSet(str(path), tuple(rule for rule in rules if rule is not None))


def _rule(name: str, table: Any, path: Path | str, faults: list[str]) -> Rule | None:
    """Return a rule; None if it has faults."""
    prefix, folder = f"{path}: rule {_shown(name)}", os.path.dirname(path)  # noqa: PTH120
    count = len(faults)
    if not name.strip():
        faults.append(f"{prefix}: a name was expected")
    if not isinstance(table, dict):
        faults.append(f"{prefix}: {_shown(table)}; a table was expected, as [rules.NAME]")
        return None
    description = table.get("description")
    if description is not None and not isinstance(description, str):
        faults.append(f"{prefix}: description: {_shown(description)}; a text was expected")
        description = None
    given = [key for key in table if key != "description"]
    unknown = [key for key in given if key not in _CONDITIONS]
    faults += [f"{prefix}: unknown condition {_shown(key)}; {_hint(key, list(_CONDITIONS))}" for key in unknown]
    known = [key for key in given if key in _CONDITIONS]
    if len(known) != 1 and not unknown:
        some = f"has the conditions {' and '.join(known)}" if known else "has no condition"
        faults.append(f"{prefix}: {some}; one of {', '.join(_CONDITIONS)} was expected")
    found = [_condition(key, table[key], prefix, faults, folder) for key in known]
    if len(faults) > count:
        return None
    (condition,) = found
    return Rule(name, condition, " ".join((description or condition.text()).split()))


def _condition(key: str, value: Any, prefix: str, faults: list[str], folder: str) -> Condition:
    """Return a condition, and add its faults."""
    fields = _Fields({key: value}, prefix, faults) if key in _PLAIN else _Fields(value, f"{prefix}: {key}", faults, folder)
    condition = _CONDITIONS[key](fields)
    fields.done()
    return condition


def _hint(name: str, known: Sequence[str], expected: str = "") -> str:
    near = get_close_matches(name[:_SHOWN], known, 1)
    return f"did you mean {near[0]}?" if near else expected or f"{', '.join(known)} were expected"


def _shown(value: Any) -> str:
    """Return a value of a file for an error."""
    if value is None:
        return "is missing"
    if type(value) is int and abs(value) > _LARGEST_COUNT:
        return "a number of many digits"
    text = repr(value[:_SHOWN] if isinstance(value, (str, list)) else value) if not isinstance(value, dict) else "a table"
    return visible(text if len(text) <= 2 * _SHOWN else f"{text[:_SHOWN]}…")
