"""Recordings of the driving simulator CARLA, without the simulator: read, convert, query, replay, show, write.

import carla_recap

with carla_recap.open_recording("crash.log") as recording:
    print(recording.info)
    print(recording.collisions())
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from carla_recap.util.lazy import lazily

# The command line prints its help without importing numpy.
_get, __dir__, __all__ = lazily(__name__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("carla-recap")
    return _get(name)
