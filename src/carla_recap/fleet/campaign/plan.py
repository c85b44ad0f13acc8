"""The runs of a campaign: a seed and parameters each, and the name of the recording that they give."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import product
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.fleet.sources import SourceFile

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from carla_recap.util.functions import Keywords

Value = bool | int | float | str
"""The value of a parameter."""

MOST: Final = 100_000
"""The most runs of a campaign."""

SEED: Final = "seed"
_RESERVED: Final = (SEED, "world", "host", "port", "checksum")  # names that scripts and files use for something else
_LONGEST_NAME: Final = 100  # characters of a parameter
_LONGEST_VALUE: Final = 10_000
_LONGEST_FILE: Final = 160  # characters of the name of a file, behind which a hash stands for the rest
_INTEGER: Final = re.compile(r"[+-]?[0-9]{1,18}")
_NUMBER: Final = re.compile(r"[+-]?([0-9]{1,40}\.?[0-9]{0,40}|\.[0-9]{1,40})([eE][+-]?[0-9]{1,3})?")
_RANGE: Final = re.compile(r"([^,\[]{1,99}?)\.\.([^,]{1,99})")
_COLON: Final = re.compile(r"([+-]?[0-9.]{1,40}):([+-]?[0-9.]{1,40})")
_UNSAFE: Final = re.compile(rb"[^A-Za-z0-9._+-]")


@dataclass(frozen=True, slots=True)
class ParameterRange:
    """The range of a parameter that a search varies; of whole numbers if both ends are."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class CampaignRun(SourceFile):
    """A run of a campaign: as a source, the recording that it gives, whose size is known if it is there already."""

    seed: int = 0  # the seed of its world
    parameters: Mapping[str, Value] = field(default_factory=dict, hash=False)  # the values by name

    @property
    def values(self) -> dict[str, Value]:
        """The seed and the parameters."""
        return {SEED: self.seed, **self.parameters}

    @property
    def texts(self) -> dict[str, str]:
        """The seed and the parameters as texts, as its recording has them."""
        return {name: text_of(value) for name, value in self.values.items()}


def text_of(value: Value) -> str:
    """Return the text of a value, from which it can be parsed."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def parse_seeds(text: str) -> Sequence[int]:
    """Return the seeds that a text means: `7`, `1,5,9`, or `1:1000` for all from 1 to 1000."""
    first, colon, last = text.partition(":")
    if colon and all(_is_seed(each) for each in (first, last)):
        if int(last) < int(first):
            raise RecapError(f"seeds {text}: end before they begin; FIRST:LAST was expected")
        return range(int(first), int(last) + 1)
    parts = text.split(",")
    if not colon and all(map(_is_seed, parts)):
        return tuple(dict.fromkeys(map(int, parts)))
    raise RecapError(f"seeds {text[:100]!r}: whole numbers were expected, such as 7, 1,5,9 or 1:1000")


def _is_seed(text: str) -> bool:
    return bool(re.fullmatch("[0-9]{1,18}", text))


def parse_parameter(text: str) -> tuple[str, Sequence[Value] | ParameterRange]:
    """Return name and values of a parameter: `speed=8,10,12`, `speed=[8, 10]` in JSON, or the range `delay=0.2..1.2`.

    Values are numbers, true and false, or else texts.
    """
    name, equals, given = text.partition("=")
    if not equals or not given:
        raise RecapError(f"parameter {text[:60]!r}: NAME=VALUE,... was expected")
    check_name(name)
    if len(given) > _LONGEST_VALUE * 10:
        raise RecapError(f"parameter {name}: {len(given):,} characters; at most {_LONGEST_VALUE * 10:,} were expected")
    if given.startswith("["):
        return name, _from_json(name, given)
    if match := _RANGE.fullmatch(given):
        low, high = map(_value, match.groups())
        if isinstance(low, str) or isinstance(high, str) or not low < high:
            raise RecapError(f"parameter {name}: {given}: is no range; LOW..HIGH was expected, such as 0.2..1.2")
        return name, ParameterRange(low, high)
    values = tuple(_value(part) for part in given.split(","))
    if "" in values:
        raise RecapError(f"parameter {name}: a value between the commas was expected")
    if match := _COLON.fullmatch(given):
        low, high = match.groups()
        expected = f'values with commas between them, the range {low}..{high} of a search, or the text ["{given}"]'
        raise RecapError(f"parameter {name}: {given}: {expected} was expected")
    return name, values


def _from_json(name: str, text: str) -> Sequence[Value]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RecapError(f"parameter {name}: a list of values in JSON was expected ({error})") from None
    if not values or not all(isinstance(each, (bool, int, float, str)) for each in values):
        raise RecapError(f"parameter {name}: a list of numbers, texts, true and false was expected")
    return tuple(values)


def _value(text: str) -> Value:
    if text in ("true", "false"):
        return text == "true"
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _NUMBER.fullmatch(text) else text


def check_name(name: str) -> None:
    """Check the name of a parameter."""
    if not (name.isidentifier() and name.isascii()) or len(name) > _LONGEST_NAME:
        expected = f"a name of letters, digits and _, of at most {_LONGEST_NAME}, was expected"
        raise RecapError(f"parameter {name[:60]!r}: {expected}")
    if name in _RESERVED:
        raise RecapError(f"parameter {name}: has a meaning of its own; expected another name")


def check_keywords(keywords: Keywords | None, names: Sequence[str]) -> None:
    """Raise `RecapError` unless a function with some keywords (None: unknown) can be called with these parameters."""
    if keywords is None:
        return
    for name in names:
        if name not in keywords.names and not keywords.has_any:
            known = ", ".join(keywords.names)[:200] or "none"
            raise RecapError(f"parameter {name}: the function has none of that name; it has {known}")
    missing = [name for name in keywords.names if name in keywords.required and name not in names]
    if missing:
        raise RecapError(f"parameter {missing[0]}: the function needs it; --param {missing[0]}=VALUE,... was expected")


def planned(seeds: Sequence[int], parameters: Mapping[str, Sequence[Value]], out: str) -> Iterator[CampaignRun]:
    """Yield all combinations of seeds and values, with recordings in a folder or behind a prefix; the seeds vary fastest."""
    count = math.prod(map(len, (seeds, *parameters.values())))
    if not 0 < count <= MOST:
        raise RecapError(f"{count:,} runs; from 1 to {MOST:,} were expected")
    names: set[str] = set()
    for values in product(*parameters.values()):
        for seed in seeds:
            run = run_of(seed, dict(zip(parameters, values, strict=True)), out)
            if run.name in names:
                raise RecapError(f"{run.name}: is in the campaign twice; other values were expected")
            names.add(run.name)
            yield run


def run_of(seed: int, parameters: Mapping[str, Value], out: str) -> CampaignRun:
    """Return a run, whose recording is below a folder or prefix."""
    if seed < 0:
        raise RecapError(f"seed {seed}: 0 or a larger whole number was expected")
    for name, value in parameters.items():
        if len(text_of(value)) > _LONGEST_VALUE:
            raise RecapError(f"parameter {name}: a value of at most {_LONGEST_VALUE:,} characters was expected")
        if isinstance(value, float) and not math.isfinite(value):
            raise RecapError(f"parameter {name}: {value:g}: a finite number was expected")
    name = file_name(seed, parameters)
    return CampaignRun(f"{out.rstrip('/') or '/'}/{name}", name=name, seed=seed, parameters=parameters)


def file_name(seed: int, parameters: Mapping[str, Value]) -> str:
    """Return the name of the recording of a run: `seed=7,speed=8.mcap`, with other characters than these as %2F."""
    name = ",".join(f"{key}={_escaped(text_of(value))}" for key, value in {SEED: seed, **parameters}.items())
    if len(name) > _LONGEST_FILE:
        name = f"{name[:_LONGEST_FILE]}~{sha256(name.encode()).hexdigest()[:16]}"
    return f"{name}.mcap"


def _escaped(text: str) -> str:
    data = text.encode("utf-8", "surrogatepass")
    return _UNSAFE.sub(lambda found: b"%%%02X" % found[0][0], data).decode("ascii")
