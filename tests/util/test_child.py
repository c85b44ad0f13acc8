"""A process that answers requests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from carla_recap.util import child as child_module
from carla_recap.util.child import started_ahead
from tests.waiting import is_running, wait_until

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
KILLED = """
import signal
from carla_recap.util.child import Child, ChildEnded

signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # as on the command line
child = Child("answering", "answers", 2)
child.process.kill()
child.process.wait()
child.send(None)
try:
    child.receive()
except ChildEnded as error:
    print(error)
"""


def test_a_request_to_a_child_that_has_ended_does_not_end_its_parent() -> None:
    parent = subprocess.run([sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True)
    assert parent.stdout == "the process that answers has ended with exit code -9\n"


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
        wait_until(lambda: not is_running(child))
    finally:
        os.kill(other, signal.SIGKILL)


def test_a_forked_process_has_no_child_of_its_parent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child_module, "Child", lambda *_: Mock())
    with started_ahead(("module", "answers", 1)):
        fork = os.fork()
        if not fork:
            os._exit(len(child_module._ahead))
        assert os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1]) == 0
