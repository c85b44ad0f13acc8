"""The benchmarks run, on a short recording; what they measure does not matter here. The pages have the stored figures."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import pytest

from benchmarks import page
from benchmarks.measuring import Line, Missing, Subject
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
    assert len(lines) == 1 + 3 + 3 + 4 + 2 + 4 + 1 + 4
    assert lines[0].split() == ["what", "measured", "ratio", "goal", "met?"]
    (equal,) = [line for line in lines if ".log → .mcap → .log" in line]
    assert equal.endswith("ok")


# --- the stored results, and the pages that are written from them ------------------------------------------------------


@pytest.fixture(scope="module")
def rows() -> list[str]:
    pytest.importorskip("msgpack", reason="the extra `server` is not installed")
    from benchmarks.__main__ import ROWS

    return [row.__name__ for row in ROWS]


def test_each_stored_result_is_that_of_a_row(rows):
    assert set(load()) <= set(rows)


def test_no_two_stored_lines_have_the_same_name():
    names = [line.what for result in load().values() for line in result.lines]
    assert len(names) == len(set(names))


def test_the_page_is_that_of_the_stored_results():
    assert page.PAGE.read_text("utf-8") == page.page(load()), "run python -m benchmarks.page"


@pytest.mark.parametrize("name", page.OTHERS)
def test_the_figures_in_another_page_are_those_of_the_stored_results(name):
    text = (ROOT / name).read_text("utf-8")
    assert page.with_figures(text, page.OTHERS[name], load()) == text, "run python -m benchmarks.page"


def test_every_figure_of_the_page_is_measured_if_all_rows_are(rows):
    if set(load()) != set(rows):
        pytest.skip("not all rows have been measured")
    assert page.figures(page.TEMPLATE.read_text("utf-8")) <= set(page.measured(load()))


CALM = Conditions("2026-01-02", "abc1234", "2 cores of Z80, Linux", "3.12.1")
FAST = Result(CALM, 12, (Line("speed", "2.04 s", "30 x real time", "≥ 20 x", True),))
SMALL = Result(replace(CALM, date="2026-01-03", commit="abc1234+"), 1, (Line("size, “all”", "4 MB", "", "", True),))


def test_stored_results_are_read_again(tmp_path):
    results = {"fast": FAST, "small": SMALL}
    save(results, tmp_path / "results.json")
    assert load(tmp_path / "results.json") == results
    assert (tmp_path / "results.json").read_text("utf-8").count("\n      {") == 2


def test_the_page_has_the_figures_of_the_results():
    assert (
        page.page({"fast": FAST}, "| it | {{ratio: speed}}: {{speed}} |") == f"| it | 30 {page.TIMES} real time: 2.04 s |\n"
    )


def test_the_page_leaves_out_what_was_not_measured():
    head = "| | |\n|---|---|\n"
    one, two = (
        f"# All\n\n## One\n\n{head}| a | {{{{speed}}}} |\n",
        f"| b | {{{{size}}}} |\n\n## Two\n\n{head}| c | {{{{size}}}} |",
    )
    assert page.page({"fast": FAST}, one + two) == f"# All\n\n## One\n\n{head}| a | 2.04 s |\n"


def test_the_page_states_when_and_on_what_the_rows_were_measured():
    usual = "2026-01-02: commit abc1234, 2 cores of Z80, Linux, Python 3.12.1"
    other = "2026-01-03: commit abc1234, changed, 2 cores of Z80, Linux, Python 3.12.1"
    assert page.page({"fast": FAST}, "{{conditions}}") == f"All figures are of {usual}.\n"
    mixed = page.page({"fast": FAST, "faster": FAST, "small": SMALL}, "{{conditions}}")
    assert mixed == f"Most figures are of {usual}.\nOthers:\n\n- `small`: {other}\n"


@pytest.mark.parametrize(("measured", "rounded"), [("4.31 s", "4"), ("35 ms", "40"), ("449 ms", "400"), ("0.12 s", "0.1")])
def test_figures_in_other_pages_have_one_digit(measured, rounded):
    result = replace(FAST, lines=(replace(FAST.lines[0], measured=measured),))
    assert (
        page.with_figures("it takes\n9 s", {"it takes ([0-9.]+) s": "speed"}, {"fast": result}) == f"it takes\n{rounded} s"
    )


def test_a_page_that_does_not_state_the_figure_is_an_error():
    with pytest.raises(ValueError, match="it takes"):
        page.with_figures("it took 9 s", {r"it takes (\d+) s": "speed"}, {"fast": FAST})


def fine(subject):
    yield Line("fine", f"{subject.frames} frames", "", "", True)


def failing(subject):
    yield Line("half", "1", "", "", True)
    raise RuntimeError


def missing(subject):
    return iter(())


def without_a_program(subject):
    raise Missing("chromedriver")


def test_a_row_whose_program_is_not_installed_names_it(capsys):
    from benchmarks.__main__ import measure_rows

    assert not measure_rows([without_a_program], Subject(7))
    printed = capsys.readouterr()
    assert "chromedriver is not installed" in printed.out
    assert "Traceback" not in printed.err


def test_a_row_that_fails_or_is_left_out_keeps_the_results_that_are_stored(rows, tmp_path, monkeypatch, capsys):
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
