"""The command that says what this installation has: what draws, extras, maps and the cache."""

from __future__ import annotations

import os
import platform
import re
from collections import defaultdict
from functools import partial
from importlib.metadata import PackageNotFoundError, distributions, requires, version
from typing import TYPE_CHECKING, Any, Final

from carla_recap.cli import options
from carla_recap.cli.output import counted, emit, indented
from carla_recap.errors import install_command
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Iterator

_PACKAGE: Final = "carla-recap"
_NO_FEATURES: Final = ("all", "dev")
"""The extras that bring nothing of their own."""
_CLIENT: Final = re.compile(r"carla-[0-9-]+")
_REQUIREMENT: Final = re.compile(r"([\w.-]+).*extra\s*==\s*['\"]([\w-]+)['\"]")
_ON_PROCESSOR: Final = re.compile(r"llvmpipe|softpipe|swrast|swiftshader|software", re.IGNORECASE)
"""The names of OpenGL devices that are programs."""


@options.command()
def doctor(form: str | None = options.json) -> None:
    """Print what this installation has, for questions and reports of faults.

    These are the versions, the device that draws pictures, the extras, the maps and the cache. What is missing is no error:
    the exit code is 0.
    """
    parts = {"versions": _versions, "drawing": _drawing, "extras": _extras, "maps": _maps, "cache": _cache}
    found = {name: part() for name, part in parts.items()}
    emit(form, json=partial(indented, found), text=partial(_text, found))


def _versions() -> dict[str, str | None]:
    return {
        _PACKAGE: _version(_PACKAGE),
        "python": platform.python_version(),
        "system": platform.platform(),
        # the client may be in a package that is named after its release
        "carla": _version("carla") or next((each.name for each in distributions() if _CLIENT.fullmatch(each.name)), None),
    }


def _drawing() -> dict[str, Any]:
    """Return the device that draws pictures, whether it is a GPU, and why there is none."""
    from carla_recap.errors import RecapError
    from carla_recap.rendering.renderer import drawing_device

    try:
        device = drawing_device()
    except Exception as error:  # also of a broken package, while it is imported
        said = str(error) if isinstance(error, RecapError) else f"{type(error).__name__}: {single_line(error)}"
        return {"device": None, "gpu": False, "error": said}
    return {**device, "gpu": _ON_PROCESSOR.search(device["device"]) is None, "error": None}


def _extras() -> dict[str, dict[str, str | None]]:
    """Return the versions of the packages of each extra; None for those that are not installed."""
    packages: defaultdict[str, dict[str, str | None]] = defaultdict(dict)
    try:
        required = requires(_PACKAGE) or []
    except (PackageNotFoundError, OSError, ValueError):
        return {}
    for match in filter(None, map(_REQUIREMENT.match, required)):
        name, extra = match.groups()
        if extra not in _NO_FEATURES and name != _PACKAGE:
            packages[extra][name] = _version(name)
    return dict(sorted(packages.items()))


def _maps() -> dict[str, Any]:
    from carla_recap.roads.find import FOLDER, find_maps

    folder = os.environ.get(FOLDER) or None
    error = _error_of(folder)
    files = {} if error else {name: str(path) for name, path in find_maps().items()}
    return {"folder": folder, "files": files, "error": error}


def _cache() -> dict[str, Any]:
    from carla_recap.util.cache import cache_folder, cache_size

    folder, (entries, size) = cache_folder(), cache_size()
    name = None if folder is None else str(folder)
    return {"folder": name, "entries": entries, "bytes": size, "error": _error_of(name)}


def _error_of(folder: str | None) -> str | None:
    """Return why a folder cannot be listed; None if it can be, or if it does not exist."""
    from carla_recap.util.files import reason_of

    try:
        if folder is not None:
            os.scandir(folder).close()
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        return reason_of(error)
    return None


def _version(package: str) -> str | None:
    """Return the version of a package; None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None
    except (OSError, ValueError) as error:  # its metadata are damaged
        return f"unknown ({type(error).__name__})"


def _text(found: dict[str, Any]) -> Iterator[str]:
    """Yield the text: headings, and lines with a name and what is said of it."""
    from carla_recap.roads.find import described_folder

    drawing, cache = found["drawing"], found["cache"]
    if drawing["error"]:
        drawn = [("none", drawing["error"])]
    else:
        kind = "a GPU" if drawing["gpu"] else "the processor, no GPU"
        drawn = [("device", f"{drawing['device']} ({kind})"), ("OpenGL", f"{drawing['version']}, {drawing['vendor']}")]
        drawn += [("EGL", drawing["egl_vendor"])] if drawing["egl_vendor"] else []
    extras = []
    for extra, packages in found["extras"].items():
        missing = [name for name, installed in packages.items() if installed is None]
        has = ", ".join(f"{name} {installed}" for name, installed in packages.items())
        extras.append((extra, f"missing: {', '.join(missing)}; {install_command(extra)}" if missing else has))
    maps = list(found["maps"]["files"].items())
    if found["maps"]["error"]:
        maps.append(("none", f"{found['maps']['folder']}: {found['maps']['error']}"))
    elif not found["maps"]["folder"] or len(maps) <= 1:
        maps.append(("others", f"none in {described_folder()}"))
    size = cache["error"] or f"{counted(cache['entries'], 'file')}, {cache['bytes'] / 1e6:.1f} MB"
    parts = {
        "Versions": [(name, text or "not installed") for name, text in found["versions"].items()],
        "Drawing": drawn,
        "Extras": extras,
        "Maps": maps,
        "Cache": [("folder", cache["folder"] or "switched off"), ("size", size)],
    }
    for heading, lines in parts.items():
        yield f"{heading}\n"
        yield from (f"  {name:<14} {text}".rstrip() + "\n" for name, text in lines)
