"""A class name means one thing in the whole package."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import carla_recap

PACKAGE = Path(carla_recap.__file__).parent


def test_no_class_name_is_defined_twice() -> None:
    modules = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        if not path.name.endswith("_pb2.py"):
            for name in re.findall(r"^ *class (\w+)[(:]", path.read_text("utf-8"), re.MULTILINE):
                modules[name].append(path.relative_to(PACKAGE).as_posix())
    assert {name: found for name, found in modules.items() if len(found) > 1} == {}
