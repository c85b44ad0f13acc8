"""Functions that harm the process in which they run."""

import os
import signal
import time


def hostile(source):
    """Do to the process what the name of the recording says."""
    name = source.location
    if name == "hangs":
        time.sleep(1000)
    if name == "is busy":
        while True:
            pass
    if name == "exits":
        os._exit(3)
    if name == "leaves a child":
        if os.fork() == 0:
            time.sleep(1000)
        os._exit(4)
    if name == "ignores SIGTERM":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(1000)
    return os.getpid()


LIMIT = 2
HOSTILE = {
    "hangs": f"hangs: takes more than {LIMIT} s",
    "is busy": f"is busy: takes more than {LIMIT} s",
    "exits": "exits: its worker process ends (exit code 3)",
    "leaves a child": "leaves a child: its worker process ends (exit code 4)",
    "ignores SIGTERM": f"ignores SIGTERM: takes more than {LIMIT} s",
}
