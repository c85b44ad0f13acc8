from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

from carla_recap.util import signals
from carla_recap.util.signals import call_on_termination, hold_termination
from tests.waiting import PATIENCE

MASK = "import signal; print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()), end='')"


def test_the_first_signal_is_handled_and_others_are_ignored() -> None:
    calls: list[str] = []
    before = signal.getsignal(signal.SIGTERM)
    for first in (signal.SIGTERM, signal.SIGINT):
        with call_on_termination(calls.append):
            for number in (first, signal.SIGINT, signal.SIGTERM):
                signal.raise_signal(number)
    assert calls == ["SIGTERM", "SIGINT"]
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_held_signal_is_handled_at_the_end_of_the_block() -> None:
    """Another thread receives it, as this one has blocked it."""
    outputs = []

    def interrupted() -> None:
        with hold_termination():
            os.kill(os.getpid(), signal.SIGINT)
            outputs.append(
                subprocess.run([sys.executable, "-c", MASK], capture_output=True, timeout=PATIENCE, check=True).stdout
            )

    ended = threading.Event()
    thread = threading.Thread(target=ended.wait)
    thread.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
    finally:
        ended.set()
        thread.join()
    assert outputs == [b"True"]
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_ignored_signal_stays_ignored() -> None:
    calls: list[str] = []
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with call_on_termination(calls.append):
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
    assert calls == []


def test_a_late_signal_ends_the_process() -> None:
    code = """
import signal, time
from carla_recap.util import signals
signals.GRACE = 1e6
with signals.call_on_termination(print):
    for _ in range(2):
        signal.raise_signal(signal.SIGINT)
    print("still there", flush=True)
    signals.GRACE = 0.0
    time.sleep(0.01)
    signal.raise_signal(signal.SIGINT)
"""
    assert outcome(code) == (-signal.SIGINT, "SIGINT\nstill there\n")


@pytest.mark.parametrize("number", signals.TERMINATION)
def test_a_command_that_is_stopped_finishes_though_more_signals_come(number: int) -> None:
    """More signals arrive during clean-up, and while the interpreter ends."""
    code = f"""
import atexit, signal, sys
from carla_recap import cli

@cli.cli.command()
def work():
    atexit.register(lambda: signal.raise_signal({int(number)}) or print("at exit", flush=True))
    try:
        signal.raise_signal({int(number)})
    finally:
        signal.raise_signal({int(number)})
        signal.raise_signal(signal.SIGTERM)
        print("finished", flush=True)

sys.argv = ["carla-recap", "work"]
cli.main()
"""
    assert outcome(code) == (128 + number, "finished\nat exit\n")


def outcome(code: str) -> tuple[int, str]:
    """Run a process; return its exit code and what it prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE)
    assert done.stderr.strip() == ""
    return done.returncode, done.stdout
