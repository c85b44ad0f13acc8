"""Recordings and running simulations as Rerun streams, arranged, with a camera behind the actor of interest.

This package is the only one that needs Rerun; importing it without the extra raises `MissingExtra`.
"""

from __future__ import annotations

from carla_recap.errors import MissingExtra

try:
    import rerun  # noqa: F401
except ImportError:
    raise MissingExtra("an export to Rerun", "rerun") from None

from carla_recap.show.rerun.blueprint import View, blueprint, camera_views, live_blueprint
from carla_recap.show.rerun.sinks import APPLICATION, Rrd, piped, sent
from carla_recap.show.rerun.writer import LiveView, write

__all__ = [
    "APPLICATION",
    "LiveView",
    "Rrd",
    "View",
    "blueprint",
    "camera_views",
    "live_blueprint",
    "piped",
    "sent",
    "write",
]
