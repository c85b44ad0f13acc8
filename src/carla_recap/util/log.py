"""The log of the package: what is done, for `-v`; without listeners it costs nothing, not even an import.

Importing `logging` takes as long as a small query. A program that listens has imported it; until then, nothing is logged.
"""

from __future__ import annotations

import sys
from typing import Any


def log_info(name: str, message: str, *values: Any) -> None:
    """Log what is done, by a logger of a module's name; the text has a `%s` for each value."""
    logging = sys.modules.get("logging")
    if logging is not None:
        logging.getLogger(name).info(message, *values)


def log_debug(name: str, message: str, *values: Any) -> None:
    """Log a detail of what is done; see `log_info`."""
    logging = sys.modules.get("logging")
    if logging is not None:
        logging.getLogger(name).debug(message, *values)
