"""The sample campaign, its rules, and the workflows for continuous integration."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.cli.command import run

SAMPLES = Path(__file__).parents[1] / "samples"
WORKFLOWS = [path for path in sorted((SAMPLES / "ci").glob("*.yml")) if "carla-recap campaign" in path.read_text("utf-8")]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a run in which the hero brakes in time, and one in which it does not."""
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    folder = tmp_path_factory.mktemp("campaign") / "runs"
    done = run("campaign", f"{SAMPLES / 'campaign.py'}:follow", "--seeds", "1,3", "--out", folder, "--pages", "0")
    assert done.returncode == 0, done.stderr
    return folder


def test_the_campaign_is_checked(runs, tmp_path):
    out = tmp_path / "out.xml"
    done = run("check", runs, "--rules", SAMPLES / "rules.toml", "--junit", out, "--html", tmp_path / "pages", "--clips")
    assert done.returncode == 1
    assert [line.split(":")[0] for line in done.stderr.decode().splitlines()] == [
        f"wrote {path}" for path in (tmp_path / "pages" / "index.html", out)
    ]
    cases = {
        (Path(case.get("classname")).name, case.get("name")): list(case) for case in ElementTree.parse(out).iter("testcase")
    }
    assert [key for key, failures in cases.items() if failures] == [
        ("seed=3.mcap", "no-hero-collision"),
        ("seed=3.mcap", "keeps-its-distance"),
        ("seed=3.mcap", "never-close-for-long"),
    ]
    assert len(cases) == 18
    assert [path.name for path in (tmp_path / "pages" / "pages").iterdir()] == ["seed-3.html"]
    assert [path.name for path in (tmp_path / "pages" / "clips").iterdir()] == ["seed-3.mcap"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_is_yaml_and_its_commands_exist(path):
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    text = path.read_text("utf-8")
    found = yaml.safe_load(text)
    jobs = found["jobs"] if path.stem == "github-actions" else found
    assert "campaign" in jobs or {"simulate", "check"} <= set(jobs)
    for command in ("campaign", "check"):
        (line,) = re.findall(rf"carla-recap ({command} .*?)(?: \||$)", text, re.MULTILINE)
        options = set(re.findall(r"--[a-z]+", run(command, "--help").stdout.decode()))
        assert set(re.findall(r"--[a-z]+", line)) <= options
    for name in re.findall(r"samples/[\w./-]+", text):
        assert (SAMPLES.parent / name).exists(), name


def test_there_are_workflows_for_both():
    assert [path.name for path in WORKFLOWS] == ["github-actions.yml", "gitlab-ci.yml"]


def test_gitlab_shows_the_junit_file_that_is_written():
    text = (SAMPLES / "ci" / "gitlab-ci.yml").read_text("utf-8")
    assert "--junit junit.xml" in text
    assert "junit: junit.xml" in text
    assert "when: always" in text
