"""Watches any CARLA server as one more of its clients: records what it sees there, or shows it.

It needs CARLA's own client library; importing this package without it raises `MissingExtra`.
"""

from __future__ import annotations

from carla_recap.errors import MissingExtra

try:
    import carla  # noqa: F401
except ImportError:
    raise MissingExtra("a capture", "carla") from None

from carla_recap.capture.recording import Captured, capture

__all__ = ["Captured", "capture"]
