"""Exports of recordings: to viewers, as videos, pictures, pages, clips and tables; each with the extra that it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_PACKAGE: Final = Path(__file__).parents[1]
_FOLDERS: Final = (_PACKAGE / "viewer", _PACKAGE.parents[1] / "viewer")  # of a wheel, and of the source tree


def viewer_folder() -> Path:
    """Return the folder of the incident page and of the Foxglove layouts."""
    return next(folder for folder in _FOLDERS if folder.is_dir())
