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


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_exists_and_is_documented(name):
    assert name in dir(carla_recap)
    found = getattr(carla_recap, name)
    assert found.__name__ == name
    assert found.__doc__


def test_the_package_lists_its_public_names():
    assert [name for name in dir(carla_recap) if not name.startswith("_")] == sorted(NAMES)


def test_another_name_is_an_error():
    with pytest.raises(AttributeError, match="module 'carla_recap' has no attribute 'wings'"):
        carla_recap.wings  # noqa: B018


def test_importing_the_package_imports_nothing_heavy():
    heavy = {"numpy", "mcap", "google.protobuf", "pandas", "zstandard"}
    code = f"import sys, carla_recap; sys.exit(bool({heavy!r} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE).returncode == 0


def test_errors_have_one_base():
    for name in ("FormatError", "NotARecording", "RecordError", "MissingExtra", "NotSetUp"):
        assert issubclass(getattr(carla_recap, name), carla_recap.RecapError)
    assert issubclass(carla_recap.MissingExtra, carla_recap.NotSetUp)
    assert issubclass(carla_recap.NoCredentials, carla_recap.NotSetUp)
    assert issubclass(carla_recap.NotARecording, carla_recap.FormatError)
    assert issubclass(carla_recap.RecapWarning, UserWarning)


def test_no_class_name_is_defined_twice() -> None:
    modules = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        if not path.name.endswith("_pb2.py"):
            for name in re.findall(r"^ *class (\w+)[(:]", path.read_text("utf-8"), re.MULTILINE):
                modules[name].append(path.relative_to(PACKAGE).as_posix())
    assert {name: found for name, found in modules.items() if len(found) > 1} == {}


@pytest.mark.parametrize("name", ["Booleans", "Buffer", "Ids", "Indices", "Span", "Table"])
def test_a_name_of_a_type_is_defined_once(name: str) -> None:
    definition = re.compile(rf"^ *(class {name}\b[(:]|{name} = )", re.MULTILINE)
    defined = [path.name for path in sorted(PACKAGE.rglob("*.py")) if definition.search(path.read_text("utf-8"))]
    assert len(defined) == 1
