"""Names: those that are public, whose import imports little; class names, each of which is defined once."""

from __future__ import annotations

import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import carla_recap
from tests.waiting import PATIENCE

NAMES = carla_recap.__all__
PACKAGE = Path(carla_recap.__file__).parent


def test_the_package_lists_its_public_names_which_exist():
    assert [name for name in dir(carla_recap) if not name.startswith("_")] == sorted(NAMES)
    assert [getattr(carla_recap, name).__name__ for name in NAMES] == NAMES


def test_another_name_is_an_error():
    with pytest.raises(AttributeError, match="module 'carla_recap' has no attribute 'wings'"):
        carla_recap.wings  # noqa: B018


def test_importing_the_package_imports_nothing_heavy():
    heavy = {"numpy", "mcap", "google.protobuf", "pandas", "zstandard"}
    code = f"import sys, carla_recap; sys.exit(bool({heavy!r} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE).returncode == 0


def test_no_name_of_a_class_or_type_is_defined_twice() -> None:
    definition = re.compile(r"^ *class (\w+)[(:]|^ *(?=(?:Booleans|Buffer|Ids|Indices|Span|Table) = )(\w+)", re.MULTILINE)
    modules = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        if not path.name.endswith("_pb2.py"):
            for found in definition.findall(path.read_text("utf-8")):
                modules["".join(found)].append(path.relative_to(PACKAGE).as_posix())
    assert {name: found for name, found in modules.items() if len(found) > 1} == {}
