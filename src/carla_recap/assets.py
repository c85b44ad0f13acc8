"""The files of `viewer/`: beside the code in a wheel, at the top of the source tree."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_HERE: Final = Path(__file__).parent
_ROOMS: Final = (_HERE / "viewer", _HERE.parents[1] / "viewer")


def viewer_folder() -> Path:
    """Where the page and the layouts are."""
    return next(room for room in _ROOMS if room.is_dir())
