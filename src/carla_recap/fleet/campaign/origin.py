"""The origin of recordings of a campaign, which is written into them: function, code, town and duration; its comparison."""

from __future__ import annotations

import inspect
import os
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.fleet.campaign.plan import text_of
from carla_recap.roads.files import read_text
from carla_recap.sim.town.loading import find_town
from carla_recap.util.functions import FileFunction
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.fleet.campaign import Campaign

_PREFIX: Final = "campaign."  # of names, which no parameter has
_DIGITS: Final = 16  # of hashes
_LABELS: Final = {
    "function": "function",
    "code": "code",
    "town": "town",
    "map": "map file",
    "duration": "duration",
    "additional_data": "additional data",
}
_LONGEST: Final = 60  # characters of a value in an error


def made_with(campaign: Campaign) -> dict[str, str]:
    """Return what a campaign makes its recordings with, besides seeds and parameters: no paths, so that machines agree."""
    name, path = _source(campaign.function)
    town, map_file = find_town(campaign.town or "", None if campaign.maps is None else Path(campaign.maps))
    try:
        code = "" if path is None else _hash(path.read_bytes())
    except OSError as error:
        raise RecapError(f"{path}: {error.strerror}; a Python file was expected") from None
    found = {
        "function": name,
        "code": code,
        "town": town,
        "map": _hash(read_text(map_file).encode("utf-8", "surrogateescape")),
        "duration": text_of(float(campaign.duration)),
        "additional_data": text_of(campaign.additional_data),
    }
    return {_PREFIX + key: value for key, value in found.items()}


def difference(parameters: Mapping[str, str], expected: Mapping[str, str]) -> str | None:
    """Return how the origin of a recording differs from the expected one, as the line of an error; None if it does not."""
    changed = [name for name, value in expected.items() if parameters.get(name) != value]
    if not changed:
        return None
    advice = "--again (in Python, again=True) makes such recordings anew, or another folder was expected"
    if not any(name.startswith(_PREFIX) for name in parameters):
        return f"is there already, and does not say which function and code made it; {advice}"
    said = []
    for name in changed:
        key = name.removeprefix(_PREFIX)
        before, now = (visible(each.get(name, ""))[:_LONGEST] or "none" for each in (parameters, expected))
        said.append(f"other {_LABELS[key]}" if key in ("code", "map") else f"{_LABELS[key]} {before} instead of {now}")
    return f"is there already, and was made with {', '.join(said)}; {advice}"


def _source(function: Callable[..., object] | str | Path) -> tuple[str, Path | None]:
    """Return the name of a function or script, and its file; None if there is none, as of a function typed in."""
    if isinstance(function, (str, os.PathLike)):
        return Path(function).name, Path(function)
    if isinstance(function, FileFunction):
        return function.name, Path(function.path)
    try:
        file = inspect.getsourcefile(inspect.unwrap(function))
    except TypeError:
        file = None
    name = getattr(function, "__qualname__", type(function).__name__)
    return name, Path(file) if file is not None and Path(file).is_file() else None


def _hash(content: bytes) -> str:
    return sha256(content).hexdigest()[:_DIGITS]
