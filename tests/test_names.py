"""A class name means one thing in the whole package."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import carla_recap

PACKAGE = Path(carla_recap.__file__).parent
REDRAWN = ("sim", "server", "capture")
"""The parts of the package in which no two classes have the same name."""
UNTIL_THE_CORE_IS_REDRAWN = {
    "Actor",
    "Actors",
    "Chunk",
    "Signals",
}
"""Names that records, queries, tables, maps, replays or exporters share with each other or with the simulator or server."""


def _modules_by_class() -> dict[str, list[str]]:
    modules = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        if not path.name.endswith("_pb2.py"):
            classes = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ClassDef))
            for node in classes:
                modules[node.name].append(path.relative_to(PACKAGE).as_posix())
    return modules


def test_no_class_name_is_defined_twice() -> None:
    twice = {name: modules for name, modules in _modules_by_class().items() if len(modules) > 1}
    assert {name: modules for name, modules in twice.items() if name not in UNTIL_THE_CORE_IS_REDRAWN} == {}


def test_no_class_name_is_defined_twice_in_the_simulator_the_server_and_the_capture() -> None:
    parts = {
        name: [module for module in modules if module.partition("/")[0] in REDRAWN]
        for name, modules in _modules_by_class().items()
    }
    assert {name: modules for name, modules in parts.items() if len(modules) > 1} == {}


def test_every_exception_is_needed() -> None:
    modules = _modules_by_class()
    assert {name for name in UNTIL_THE_CORE_IS_REDRAWN if len(modules[name]) < 2} == set()
