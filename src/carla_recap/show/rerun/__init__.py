"""Recordings and running simulations as Rerun streams, arranged, with a camera behind the actor of interest.

This package alone needs Rerun; it can be imported without: `check_rerun` says whether it is there.
"""

from __future__ import annotations

import os
from typing import Final

from carla_recap.errors import MissingExtra

_LOG: Final = "warn,re_log_encoding=off,re_sdk::recording_stream=off"  # what fails there, errors say


def check_rerun() -> None:
    """Import Rerun, so that it does not log what this package says, or raise `MissingExtra`."""
    given = os.environ.get("RUST_LOG")
    os.environ.setdefault("RUST_LOG", _LOG)  # is read once
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise MissingExtra("an export to Rerun", "rerun") from None
    finally:
        if given is None:
            del os.environ["RUST_LOG"]
