"""A class name means one thing in the whole package."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import carla_recap

PACKAGE = Path(carla_recap.__file__).parent
REASONS = {
    "Actor": "public in both `carla_recap`, an actor of a recording, and `carla_recap.sim`, an actor of a simulated world",
}
"""Names that two classes have, and why."""


def test_no_class_name_is_defined_twice() -> None:
    modules = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        if not path.name.endswith("_pb2.py"):
            for name in re.findall(r"^ *class (\w+)[(:]", path.read_text("utf-8"), re.MULTILINE):
                modules[name].append(path.relative_to(PACKAGE).as_posix())
    repeated = {name: found for name, found in modules.items() if len(found) > 1}
    assert {name: found for name, found in repeated.items() if name not in REASONS} == {}
    assert set(REASONS) <= set(repeated)
