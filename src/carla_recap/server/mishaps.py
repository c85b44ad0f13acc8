"""What goes wrong inside the server and must not end it: a line on stderr, once for each text."""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Final

_MOST: Final = 256  # texts that are known to have been told


def tell(what: str, error: BaseException | None = None) -> None:
    """Say in a line what has gone wrong, unless that has just been said."""
    _say_once(what if error is None else f"{what}: {error!r}")


@lru_cache(maxsize=_MOST)
def _say_once(text: str) -> None:
    print(f"carla-recap: {text}", file=sys.stderr, flush=True)
