"""Child processes: their import path, and how they are ended."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from carla_recap.util.processes import (
    environment_of_user,
    is_readable,
    module_command,
    module_environment,
    terminate,
)

STUBBORN = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('ready', flush=True); time.sleep(1000)"


def test_a_module_is_run_with_the_import_path_of_this_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "path").mkdir()
    (tmp_path / "path" / "mine.py").write_text("import os, carla_recap; print(os.environ['COLOR'])")
    (tmp_path / "carla_recap.py").write_text("raise SystemExit(7)")  # in the working directory, and not imported
    monkeypatch.syspath_prepend("path")
    monkeypatch.chdir(tmp_path)
    done = subprocess.run(module_command("mine"), env=module_environment(COLOR="red"), capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "red\n", "")


def test_scripts_of_the_user_have_as_many_threads_as_the_user_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "1")
    assert environment_of_user()["OPENBLAS_NUM_THREADS"] == "1"
    monkeypatch.setenv("CARLA_RECAP_ONE_THREAD", "1")  # as the command line sets it with the other one
    assert not {"OPENBLAS_NUM_THREADS", "CARLA_RECAP_ONE_THREAD"} & set(environment_of_user())


def test_a_process_that_ignores_sigterm_is_killed() -> None:
    with subprocess.Popen([sys.executable, "-c", STUBBORN], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert terminate(process, 0.2) == -9


def test_what_is_in_the_buffer_of_a_pipe_is_readable() -> None:
    theirs, ours = os.pipe()
    with os.fdopen(theirs, "rb") as pipe, os.fdopen(ours, "wb", buffering=0) as writing:
        assert not is_readable(pipe, 0.0)
        writing.write(b"ab")
        assert is_readable(pipe, 0.0)
        assert pipe.read(1) == b"a"
        assert is_readable(pipe, 0.0)
        assert pipe.read(1) == b"b"
        assert not is_readable(pipe, 0.0)
        writing.close()
        assert is_readable(pipe, 0.0)
