"""The folder of the incident page, the Foxglove layouts and the models."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_PACKAGE: Final = Path(__file__).parents[1]
_FOLDERS: Final = (_PACKAGE / "viewer", _PACKAGE.parents[1] / "viewer")  # of a wheel, and of the source tree


def viewer_folder() -> Path:
    """Return the folder of the files that viewers read."""
    return next(folder for folder in _FOLDERS if folder.is_dir())
