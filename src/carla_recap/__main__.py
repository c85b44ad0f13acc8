"""The command line, as `carla-recap`, `CarlaUE4.sh` and `python -m carla_recap`.

Until the commands are imported, Ctrl-C ends the process as any other program, without Python's traceback.
"""

from __future__ import annotations

import os
import signal

# The matrices here are small: a thread for each core, which numpy starts otherwise, makes commands slower.
if "OPENBLAS_NUM_THREADS" not in os.environ:
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "CARLA_RECAP_ONE_THREAD": "1"}  # see `environment_of_user`


def main() -> None:
    """Run the command line."""
    with _Start():
        from carla_recap.cli import main as run
    run()


def launch() -> None:
    """Run the server with the arguments of CARLA's own."""
    with _Start():
        from carla_recap.cli.server import launch as run
    run()


class _Start:
    """A `with` block in which Ctrl-C has the system's own effect, unless it is ignored."""

    def __enter__(self) -> None:
        self._before = signal.getsignal(signal.SIGINT)
        if self._before is signal.default_int_handler:
            signal.signal(signal.SIGINT, signal.SIG_DFL)

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)


if __name__ == "__main__":
    main()
