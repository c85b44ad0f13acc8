from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import psutil
import pytest

from carla_recap.errors import RecapError
from carla_recap.fleet.engine import map_sources
from carla_recap.fleet.sources import SourceFile
from tests.fleet.hostile import HOSTILE, LIMIT, hostile
from tests.waiting import PATIENCE, time_limit, wait_until


def sources(count):
    return [SourceFile(f"{index}.log") for index in range(count)]


def process(_):
    return os.getpid()


def end_once(source, folder):
    """End the process the first time that recording 7 is read."""
    if source.location == "7.log" and not (folder / "ended").exists():
        (folder / "ended").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return source.location


def end_always(source):
    if source.location in ("7.log", "8.log"):
        os._exit(3)
    return source.location


def fail(source):
    if source.location == "3.log":
        raise KeyError("three")
    return source.location


def wait_for(source, folder):
    (folder / source.location).touch()
    time.sleep(1000)


def unpicklable(_):
    return threading.Lock()


def values(function, count=60):
    with time_limit():
        return list(map_sources(function, sources(count), jobs=2))


def test_a_worker_that_is_killed_loses_no_recording_and_pipes_end_this_process_as_before(tmp_path):
    before = signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    try:
        outcomes = values(partial(end_once, folder=tmp_path))
        assert signal.getsignal(signal.SIGPIPE) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGPIPE, before)
    assert (tmp_path / "ended").exists()
    assert [outcome.value for outcome in outcomes] == [source.location for source in sources(60)]


def test_a_recording_that_ends_its_workers_has_an_error_and_others_have_none():
    outcomes = values(end_always)
    errors = {outcome.source.location: outcome.error for outcome in outcomes if outcome.error}
    assert errors == {name: f"{name}: its worker process ends (exit code 3)" for name in ("7.log", "8.log")}
    assert [outcome.source for outcome in outcomes] == sources(60)


class StartsOnce:
    """A function whose first worker alone can start."""

    def __init__(self, folder):
        self.folder = folder

    def prepare(self):
        try:
            (self.folder / "first").touch(exist_ok=False)
        except FileExistsError:
            time.sleep(0.3)  # so that the first worker has an outcome
            os._exit(3)

    def __call__(self, _):
        time.sleep(0.05)
        return 1


def test_workers_that_do_not_start_are_no_error_while_another_one_works(tmp_path):
    assert [outcome.value for outcome in values(StartsOnce(tmp_path))] == [1] * 60


def test_a_pipe_that_breaks_is_the_end_of_a_worker(monkeypatch):
    def broken(*_):
        raise BrokenPipeError  # as on Windows

    monkeypatch.setattr(Connection, "poll", broken)
    with pytest.raises(RecapError, match="the worker processes do not start"):
        values(process)


def test_another_error_of_the_function_is_raised_with_the_place_where_it_was():
    with pytest.raises(KeyError, match="three") as caught:
        values(fail)
    assert "in fail" in caught.value.__notes__[0]


def test_a_value_that_cannot_be_sent_is_an_error():
    with pytest.raises(TypeError, match="pickle"):
        values(unpicklable)


def test_an_iterator_that_is_closed_leaves_no_processes():
    outcomes = map_sources(process, sources(200), jobs=2)
    workers = {next(outcomes).value}
    outcomes.close()
    assert not multiprocessing.active_children()
    for worker in workers:
        with pytest.raises(ProcessLookupError):
            os.kill(worker, 0)


def test_a_script_without_a_guard_has_an_error_that_says_so(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from carla_recap.fleet.engine import map_sources\n"
        "from carla_recap.fleet.sources import SourceFile\n"
        "print(list(map_sources(len, [SourceFile('a')], jobs=2)))\n"
    )
    done = subprocess.run([sys.executable, script], capture_output=True, timeout=PATIENCE, check=False)
    assert done.returncode == 1
    assert "the worker processes do not start (exit code 1)" in done.stderr.decode().splitlines()[-1]


def test_many_outcomes_are_not_held_while_none_is_asked_for():
    taken = 0

    def endless():
        nonlocal taken
        while True:
            taken += 1
            yield SourceFile(f"{taken}.log")

    outcomes = map_sources(process, endless(), jobs=2)
    for _ in range(300):
        next(outcomes)
    outcomes.close()
    assert taken < 300 + 200


def test_workers_that_are_busy_end_at_once(tmp_path):
    started = threading.Event()

    def watch():
        wait_until((tmp_path / "1.log").exists)
        started.set()
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=watch).start()
    with pytest.raises(KeyboardInterrupt):
        list(map_sources(partial(wait_for, folder=tmp_path), sources(5), jobs=2))
    assert started.is_set()
    assert not multiprocessing.active_children()


def interrupts_are_held(_):
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_ctrl_c_is_held_while_a_worker_starts(monkeypatch):
    held = []
    start = BaseProcess.start

    def started(self):
        held.append(interrupts_are_held(None))
        start(self)

    monkeypatch.setattr(BaseProcess, "start", started)
    assert not any(outcome.value for outcome in values(interrupts_are_held, 4))
    assert held == [True] * len(held) != []
    assert not interrupts_are_held(None)


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_a_function_with_a_limit_may_do_anything_to_its_process():
    names = ["a", *HOSTILE, "b"]
    with time_limit():
        outcomes = list(map_sources(hostile, map(SourceFile, names), jobs=2, limit=LIMIT))
    assert [outcome.error for outcome in outcomes] == [None, *HOSTILE.values(), None]
    assert os.getpid() not in {outcome.value for outcome in outcomes}
    assert not multiprocessing.active_children()


def test_workers_with_a_limit_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "from functools import partial\n"
        "from pathlib import Path\n"
        "from carla_recap.fleet.engine import map_sources\n"
        "from carla_recap.fleet.sources import SourceFile\n"
        "from tests.fleet.test_workers import wait_for\n"
        "if __name__ == '__main__':\n"
        "    list(map_sources(partial(wait_for, folder=Path(__file__).parent), [SourceFile('1.log')], jobs=1, limit=1000))\n"
    )
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), *sys.path])}
    with subprocess.Popen([sys.executable, script], env=environment) as process:
        wait_until((tmp_path / "1.log").exists)
        (worker,) = [child for child in psutil.Process(process.pid).children() if "spawn_main" in " ".join(child.cmdline())]
        process.kill()
    wait_until(lambda: not worker.is_running() or worker.status() == psutil.STATUS_ZOMBIE)
