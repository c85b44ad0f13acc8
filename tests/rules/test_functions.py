"""Conditions in Python, in this process, in worker processes and on a Dask cluster."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from textwrap import dedent

import pytest

from carla_recap import Verdict, check, load_rules, open_recording
from carla_recap.errors import RecapError
from carla_recap.fleet.check import check_sources
from carla_recap.fleet.sources import find_sources
from carla_recap.rules.rule_sets import RulesError
from tests.cli.command import run
from tests.samples import SAMPLES, save

FUNCTIONS = """
from __future__ import annotations

import dataclasses
import sys

import numpy as np

import beside
from carla_recap import Finding, Offence


@dataclasses.dataclass
class Limit:
    value: float


def slow_start(recording, limit, after=1.0):
    \"""Nobody is fast at the start.

    More words.
    \"""
    path = recording.trajectory("hero")
    fast = np.flatnonzero((path.speed > Limit(limit).value) & (path.time <= after))
    for row in fast[:1]:
        yield Offence(f"hero drives at {path.speed[row]:.1f} m/s", path.time[row], (np.int64(path.id),))


def finding(recording):
    return Finding(False, "it is a \\x1b[31m Monday", [Offence("hero is late", None, ())])


def passing(recording):
    return Finding(np.bool_(True), "all is well")


def nothing(recording):
    return []


def returns(recording, what):
    return eval(what)


def raises(recording):
    return beside.divided(1, 0)


def ends(recording):
    sys.exit(3)


not_a_function = 3
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "my_rules.py").write_text(FUNCTIONS, "utf-8")
    (tmp_path / "beside.py").write_text("def divided(a, b):\n    return a / b\n", "utf-8")
    return tmp_path


def judged(folder: Path, condition: str, sample: str = "crash.mcap") -> Verdict:
    rules = load_rules(save(folder / "rules.toml", f"[rules.it]\ncondition = {condition}".encode()))
    with open_recording(SAMPLES / sample) as recording:
        return check(recording, rules)[0]


def faults(folder: Path, condition: str) -> str:
    with pytest.raises(RulesError) as caught:
        load_rules(save(folder / "rules.toml", f"[rules.it]\ncondition = {condition}".encode()))
    (fault,) = caught.value.faults
    start = f"{folder / 'rules.toml'}: rule 'it': condition"
    assert fault.startswith(start)
    return fault.removeprefix(start)


def test_offences_of_a_generator_are_those_of_the_verdict(folder: Path) -> None:
    found = judged(folder, '{ function = "my_rules:slow_start", limit = 10, after = 15 }')
    assert (found.status, found.actors) == ("fail", (41,))
    assert re.fullmatch(r"slow_start finds 1 offence: hero drives at 10\.\d m/s at \d+\.\d\d s", found.message)
    assert type(found.time) is float
    assert type(found.actors[0]) is int
    found = judged(folder, '{ function = "my_rules:slow_start", limit = 50, after = 9 }')
    assert (found.status, found.message) == ("pass", "slow_start finds no offence")


def test_a_finding_is_the_verdict(folder: Path) -> None:
    found = judged(folder, '"my_rules:finding"')
    assert (found.status, found.message) == ("fail", "it is a \\x1b[31m Monday: hero is late")
    assert judged(folder, '"my_rules:passing"').message == "all is well"
    assert judged(folder, '"my_rules:nothing"').status == "pass"
    found = judged(folder, '{ function = "my_rules:returns", what = "Finding(True, \'no tram\', applies=False)" }')
    assert (found.status, found.applies, found.message) == ("pass", False, "nothing to judge: no tram")


def test_a_function_can_be_named_by_its_file(folder: Path) -> None:
    assert judged(folder, '"my_rules.py:passing"').message == "all is well"
    (folder / "below").mkdir()
    assert judged(folder / "below", '"../my_rules.py:passing"').message == "all is well"


def test_the_description_is_the_first_line_of_the_docstring(folder: Path) -> None:
    text = (
        '[rules.a]\ncondition = { function = "my_rules:slow_start", limit = 5 }\n[rules.b]\ncondition = "my_rules:nothing"'
    )
    rules = load_rules(save(folder / "rules.toml", text.encode()))
    assert [rule.description for rule in rules] == ["Nobody is fast at the start", "my_rules:nothing"]


@pytest.mark.parametrize(
    "value",
    [
        *("None", "True", "5", "'text'", "{}", "[3]", "[Offence(3)]", "[Offence('a', 'b')]", "[Offence('a', float('nan'))]"),
        *(
            "[Offence('a', 1.0, ('b',))]",
            "Finding(2, 'a')",
            "Finding(np.ones(2) > 0, 'a')",
            "Finding(True, 3)",
            "Finding(False, 'a', None)",
            "Finding(True, 'a', (), 3)",
            "'x' * 5000",
        ),
    ],
)
def test_what_is_no_finding_cannot_be_judged(folder: Path, value: str) -> None:
    found = judged(folder, f'{{ function = "my_rules:returns", what = "{value}" }}')
    assert found.status == "error"
    assert found.message.startswith("my_rules:returns returns ")
    assert found.message.endswith("; expected a Finding, or the Offences that break the rule")
    assert len(found.message) < 200


def test_an_error_of_a_function_is_one_line_with_the_file_and_the_line(folder: Path) -> None:
    found = judged(folder, '"my_rules:raises"')
    assert found.status == "error"
    assert found.message == "my_rules:raises raises ZeroDivisionError: division by zero (beside.py, line 2)"
    assert judged(folder, '"my_rules:ends"').message.startswith("my_rules:ends raises SystemExit: 3 (my_rules.py, line ")
    found = judged(folder, '{ function = "my_rules:returns", what = "recording.trajectory(99)" }')
    assert found.message.startswith("no actor 99; known ids are 41 (hero), ")


def test_what_a_function_prints_is_no_verdict(folder: Path) -> None:
    save(folder / "noisy.py", b"print('imported')\ndef it(recording):\n    print('looking')\n    return []\n")
    save(folder / "rules.toml", b"[rules.it]\ncondition = 'noisy:it'")
    for jobs in ("1", "2"):
        done = run("check", SAMPLES / "crash.mcap", "--rules", folder / "rules.toml", "--json", "--jobs", jobs)
        assert json.loads(done.stdout)["counts"]["pass"] == 1
        assert b"looking\n" in done.stderr


@pytest.mark.parametrize(
    ("condition", "fault"),
    [
        ("3", ': expected a function as "FILE.py:function" or "module:function", found 3'),
        ("'my_rules'", ': expected a function as "FILE.py:function" or "module:function", found \'my_rules\''),
        ("{ limit = 3 }", '.function: expected a function as "FILE.py:function" or "module:function", found nothing'),
        ("'absent_rules:f'", ": there is no module absent_rules, in "),
        ("'my_rules:absent'", ": the module my_rules has no function absent"),
        ("'my_rules.py:not_a_function'", ": the module my_rules.py has no function not_a_function"),
        ("'my_rules:slow_start'", ": my_rules:slow_start: missing a required argument: 'limit'; the function gets the"),
        ("{ function = 'my_rules:nothing', limit = 3 }", ": unknown key 'limit'; the key is function"),
        ("{ function = 'my_rules.py:slow_start', limt = 3 }", ": unknown key 'limt'; did you mean limit? The keys are"),
        ("'absent.py:f'", ": there is no file "),
        ("'broken.py:f'", ": the module broken.py cannot be imported: SyntaxError: "),
        ("'broken:f'", ": the module broken cannot be imported: SyntaxError: "),
        ("'lacking:f'", ": the module lacking cannot be imported: ModuleNotFoundError: No module named 'absent_too' ("),
    ],
)
def test_a_function_that_is_not_there_is_a_fault_of_the_file(folder: Path, condition: str, fault: str) -> None:
    (folder / "broken.py").write_text("def f(:\n", "utf-8")
    (folder / "lacking.py").write_text("import absent_too\n", "utf-8")
    assert faults(folder, condition).startswith(fault)


def test_modules_of_two_folders_have_one_name_and_a_changed_one_is_imported_anew(tmp_path: Path) -> None:
    text = "from carla_recap import Finding\ndef it(recording):\n    return Finding(True, '{}')\n"
    for name in ("one", "two", "two"):
        (tmp_path / name).mkdir(exist_ok=True)
        words = f"{name}{'!' * (tmp_path / name / 'shared_name.py').exists()}"
        (tmp_path / name / "shared_name.py").write_text(text.format(words), "utf-8")
        assert judged(tmp_path / name, '"shared_name:it"').message == words


def test_an_installed_module_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (package := tmp_path / "installed" / "rules_of_ours").mkdir(parents=True)
    save(package / "__init__.py", b"")
    save(package / "speed.py", b"def it(recording, at):\n    return []\n")
    monkeypatch.syspath_prepend(tmp_path / "installed")
    assert judged(tmp_path, '{ function = "rules_of_ours.speed:it", at = [1, 2] }').status == "pass"


@pytest.fixture
def runs(folder: Path) -> Path:
    (folder / "runs").mkdir()
    for name in ("crash", "junction", "avoided"):
        shutil.copy(SAMPLES / f"{name}.mcap", folder / "runs")
    rules = """
        [rules.python]
        condition = { function = "my_rules:slow_start", limit = 5 }
        [rules.wrong]
        condition = "my_rules:raises"
    """
    save(folder / "rules.toml", dedent(rules).encode())
    return folder / "runs"


def test_workers_and_a_cluster_judge_by_functions(runs: Path) -> None:
    rules = load_rules(runs.parent / "rules.toml")
    alone, shared = ([each.verdicts for each in check_sources(find_sources([str(runs)]), rules, jobs=n)] for n in (1, 2))
    assert alone == shared
    said = "my_rules:raises raises ZeroDivisionError: division by zero (beside.py, line 2)"
    assert {verdicts[1].message for verdicts in shared} == {said}
    distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
    options = {"host": "127.0.0.1", "dashboard_address": None, "silence_logs": 50}
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, **options) as cluster,
        distributed.Client(cluster) as client,
    ):
        assert [each.verdicts for each in check_sources(find_sources([str(runs)]), rules, client=client)] == alone
        (runs.parent / "my_rules.py").unlink()
        with pytest.raises(RecapError, match=r"the Dask worker tcp://.*: there is no module my_rules, in ") as caught:
            list(check_sources(find_sources([str(runs)]), rules, client=client))
    assert "\n" not in str(caught.value)
