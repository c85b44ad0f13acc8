"""The benchmarks run, on a short recording; what they measure does not matter here. The pages have the stored figures."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import pytest

from benchmarks import page
from benchmarks.measuring import Line, Subject
from benchmarks.results import Conditions, Result, load, save
from tests.samples import ROOT
from tests.waiting import PATIENCE

ROWS = ("mcap_to_log", "collisions", "blocked", "incidents", "differences", "info_all", "remote")


def test_the_benchmarks_run(tmp_path):
    pytest.importorskip("msgpack", reason="the extra `server` is not installed")
    command = [sys.executable, "-m", "benchmarks", "--frames", "100", *(f"--only={row}" for row in ROWS)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 1 + 3 + 3 + 3 + 2 + 4 + 1 + 4
    assert lines[0].split() == ["what", "measured", "ratio", "goal", "met?"]
    (equal,) = [line for line in lines if ".log → .mcap → .log" in line]
    assert equal.endswith("ok")


def test_the_page_is_that_of_the_stored_results():
    assert page.PAGE.read_text("utf-8") == page.page(load()), "run python -m benchmarks.page"


@pytest.mark.parametrize("name", page.OTHERS)
def test_the_figures_in_another_page_are_those_of_the_stored_results(name):
    text = (ROOT / name).read_text("utf-8")
    assert page.with_figures(text, page.OTHERS[name], load()) == text, "run python -m benchmarks.page"


CALM = Conditions("2026-01-02", "abc1234", "2 cores of Z80, Linux", "3.12.1")
FAST = Result(CALM, (Line("speed", "2.04 s", "30 x real time", "≥ 20 x", True),))
SMALL = Result(replace(CALM, date="2026-01-03", commit="abc1234+"), (Line("size, “all”", "4 MB", "", "", True),))


def fine(subject):
    yield Line("fine", f"{subject.frames} frames", "", "", True)


def failing(subject):
    yield Line("half", "1", "", "", True)
    raise RuntimeError


def missing(subject):
    return iter(())


def test_a_row_that_fails_or_is_left_out_keeps_the_results_that_are_stored(tmp_path, monkeypatch, capsys):
    pytest.importorskip("msgpack", reason="the extra `server` is not installed")
    from benchmarks import __main__ as benchmarks

    stored = tmp_path / "results.json"
    save({"failing": FAST, "missing": SMALL, "gone": SMALL}, stored)
    monkeypatch.setattr(benchmarks, "ROWS", (failing, missing, fine))
    assert benchmarks.measure_rows(benchmarks.ROWS, Subject(7), stored)
    results = load(stored)
    assert list(results) == ["failing", "missing", "fine"]
    assert (results["failing"], results["missing"]) == (FAST, SMALL)
    assert results["fine"].lines == (Line("fine", "7 frames", "", "", True),)
    assert "RuntimeError" in capsys.readouterr().err
