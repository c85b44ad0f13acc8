"""A process that answers requests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

import psutil

from tests.waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

CHILD = """
import os, pathlib, time
from carla_recap.util.child import answer_requests

def begin(path):
    pathlib.Path(path).write_text(str(os.getpid()))
    return lambda: time.sleep(0.5)

answer_requests(lambda setup: begin)
"""
PARENT = """
import os, pathlib, signal, sys, time
from carla_recap.util.child import Child

child = Child("answering", "answers", 2)
child.send(None)
child.receive()
other = os.fork()
if not other:
    time.sleep(600)
child.send(sys.argv[1])
while not pathlib.Path(sys.argv[1]).exists():
    time.sleep(0.01)
print(child.process.pid, other, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_child_whose_parent_dies_during_a_request_ends_though_others_hold_its_connection(tmp_path: Path) -> None:
    (tmp_path / "answering.py").write_text(CHILD)
    (tmp_path / "parent.py").write_text(PARENT)
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py"), str(tmp_path / "begun")], stdout=subprocess.PIPE, text=True
    )
    with parent:
        assert parent.stdout is not None
        child, other = map(int, parent.stdout.readline().split())
    try:
        wait_until(lambda: not _is_running(child))
    finally:
        os.kill(other, signal.SIGKILL)


def _is_running(pid: int) -> bool:
    with suppress(psutil.NoSuchProcess):
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    return False
