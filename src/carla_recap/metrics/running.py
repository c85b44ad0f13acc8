"""Metric files as written for ScenarioRunner, run on a recording, with ScenarioRunner installed or not."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import FormatError, RecapError
from carla_recap.roads.drawing import load_map
from carla_recap.util.files import read_document

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.metrics.log import MetricsLog

_BASE: Final = "srunner.metrics.examples.basic_metric"
_TRIAL: Final = "import carla, sys; carla.Map('', sys.stdin.read())"
_PATIENCE: Final = 60.0  # s, for CARLA's library to read a map
_LOG: Final = "srunner.metrics.tools.metrics_log"
_LARGEST_CRITERIA: Final = 64 << 20  # bytes


class BasicMetric:
    """Base of metrics, in the absence of ScenarioRunner's class of this name.

    Args:
        town_map: The map, a `carla.Map`; None if it is unknown.
        log: The log of the recording.
        criteria: The criteria by name; None without a file of them.
    """

    def __init__(self, town_map: Any, log: MetricsLog, criteria: dict[str, Any] | None = None) -> None:
        self._create_metric(town_map, log, criteria)

    def _create_metric(self, town_map: Any, log: MetricsLog, criteria: dict[str, Any] | None) -> None:
        """Compute the metric; every metric has its own."""
        raise NotImplementedError(f"{type(self).__name__} has no method _create_metric")


def run_metric(
    metric: Path | str, log: MetricsLog, *, opendrive: Path | str | None = None, criteria: Path | str | None = None
) -> object:
    """Run the first metric of a file, by name, and return it.

    Args:
        metric: The Python file, which has a class that extends `BasicMetric` of ScenarioRunner.
        log: The log of the recording.
        opendrive: The map of the town, an OpenDRIVE file.
        criteria: A JSON file with the criteria, as ScenarioRunner writes it.

    Raises:
        RecapError: A file cannot be read, or has no metric. What the metric itself raises is passed on.
    """
    given = None if criteria is None else _criteria(Path(criteria))
    town_map = None if opendrive is None else _town_map(Path(opendrive))
    with _importing(Path(metric)):
        return _metric_class(Path(metric))(town_map, log, given)


@contextmanager
def _importing(path: Path) -> Iterator[None]:
    """Import modules from the folder of a file first, anew; afterwards all is as before."""
    folder = path.parent.absolute()
    own = {each.stem for each in folder.glob("*.py")} | {each.parent.name for each in folder.glob("*/__init__.py")}
    own = {name for name in own & sys.modules.keys() if name == path.stem or not _is_in(folder, name)}
    aside = {name: sys.modules.pop(name) for name in list(sys.modules) if name.partition(".")[0] in own}
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        new = {name for name in sys.modules.keys() - before if "." not in name and _is_in(folder, name)}
        for name in [name for name in sys.modules if name.partition(".")[0] in new]:
            del sys.modules[name]
        sys.modules.update(aside)


def _is_in(folder: Path, name: str) -> bool:
    """Return whether a module or a package has been imported from a folder."""
    places = (*getattr(sys.modules[name], "__path__", ()), getattr(sys.modules[name], "__file__", None) or "")
    return any(Path(place).parent == folder for place in places)


def _criteria(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(read_document(path, _LARGEST_CRITERIA, "a JSON file of criteria"))
    except (ValueError, RecursionError) as error:
        raise RecapError(f"{path}: is no JSON file ({error})") from None
    if not isinstance(found, dict):
        raise RecapError(f"{path}: expected an object with a member for each criterion")
    return found


def _town_map(path: Path) -> Any:
    """Return a `carla.Map`, after a child process has read the file: CARLA's library crashes on damaged ones."""
    import carla

    text = load_map(path).opendrive
    try:
        done = subprocess.run(
            [sys.executable, "-c", _TRIAL], input=text.encode(), capture_output=True, timeout=_PATIENCE, check=False
        )
        failed = done.returncode != 0
    except subprocess.TimeoutExpired:
        failed = True
    if failed:
        raise FormatError(path, None, "expected an OpenDRIVE map, found a file on which CARLA's library breaks down")
    return carla.Map(path.stem, text)


def _metric_class(path: Path) -> Any:
    if not path.is_file() or path.suffix != ".py":
        raise RecapError(f"{path}: expected a metric's .py file, found {'another' if path.exists() else 'no such file'}")
    _provide_scenario_runner()
    module = import_module(path.stem)
    for _, member in inspect.getmembers(module, inspect.isclass):
        if any(base.__name__ == BasicMetric.__name__ for base in member.__mro__[1:]):
            return member
    raise RecapError(f"{path}: no class in it extends BasicMetric")


def _provide_scenario_runner() -> None:
    """Make the modules that metrics import, unless ScenarioRunner is installed."""
    if _is_installed(_BASE):
        return
    from carla_recap.metrics.log import MetricsLog

    for name in [name for name in sys.modules if name.partition(".")[0] == "srunner"]:
        del sys.modules[name]  # such as those of a folder for results
    for name, content in ((_BASE, BasicMetric), (_LOG, MetricsLog)):
        parts = name.split(".")
        parent = None
        for depth in range(1, len(parts) + 1):
            module = sys.modules.setdefault(".".join(parts[:depth]), ModuleType(".".join(parts[:depth])))
            module.__path__ = []
            if parent is not None:
                setattr(parent, parts[depth - 1], module)
            parent = module
        setattr(parent, content.__name__, content)


def _is_installed(module: str) -> bool:
    try:
        return module in sys.modules or find_spec(module) is not None
    except ModuleNotFoundError:
        return False
