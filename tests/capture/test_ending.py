from __future__ import annotations

import signal
import subprocess
import sys

from carla_recap.capture.ending import ended_by_signals


def test_a_signal_is_told_and_the_process_goes_on() -> None:
    told: list[str] = []
    before = signal.getsignal(signal.SIGTERM)
    with ended_by_signals(told.append):
        signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    assert told == ["SIGTERM"]
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_second_signal_ends_the_process() -> None:
    code = """
import signal
from carla_recap.capture.ending import ended_by_signals
with ended_by_signals(print):
    signal.raise_signal(signal.SIGINT)
    print("still there", flush=True)
    signal.raise_signal(signal.SIGINT)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout) == (-signal.SIGINT, "SIGINT\nstill there\n")
