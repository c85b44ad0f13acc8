"""Names of a package that are imported when they are first used (PEP 562), of a list that type checkers read, too."""

from __future__ import annotations

import re
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable


def lazily(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return the `__getattr__`, the `__dir__` and the `__all__` of a package.

    Its names are those that its `__init__.pyi` imports, a line each: `from carla_recap.editing.clip import clip as clip`.
    """
    module: Any = sys.modules[package]
    stub = module.__loader__.get_data(f"{module.__file__}i").decode()
    modules = {name: module for module, name in re.findall(r"^from (\S+) import \w+ as (\w+)$", stub, re.MULTILINE)}

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(modules[name]), name)
        setattr(module, name, found)
        return found

    def list_names() -> list[str]:
        return sorted([*modules, *(name for name in vars(module) if name.startswith("__"))])

    return get, list_names, sorted(modules)
