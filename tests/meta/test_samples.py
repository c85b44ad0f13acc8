"""The samples: queries find what happens in recordings, which their script makes again; a campaign, workflows for CI."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.cli.command import COMMAND, ENVIRONMENT, run
from tests.samples import SAMPLES, images
from tests.waiting import PATIENCE

WORKFLOWS = [path for path in sorted((SAMPLES / "ci").glob("*.yml")) if "carla-recap campaign" in path.read_text("utf-8")]


def test_the_script_makes_the_same_frames(tmp_path):
    """Of about a third of the time of each recording."""
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    pytest.importorskip("carla", reason="the extra `carla` is not installed")
    environment = ENVIRONMENT | {"PATH": f"{COMMAND.parent}{os.pathsep}{os.environ['PATH']}"}
    environment["OPENBLAS_CORETYPE"] = "Prescott"  # as on a machine whose processor has fewer instructions
    environment["GLIBC_TUNABLES"] = "glibc.cpu.hwcaps=-FMA,-AVX2"
    script = (SAMPLES / "make_recordings.sh").read_text("utf-8")
    for whole, part in (("--duration 60", "--duration 20"), ("--duration 30", "--duration 10"), ("--then 15", "--then 5")):
        assert whole in script
        script = script.replace(whole, part)
    command = ["bash", "-c", script, "make_recordings.sh", tmp_path]
    subprocess.run(command, env=environment, timeout=PATIENCE, check=True, capture_output=True)
    for name in ("avoided", "blocked", "crash", "junction"):
        *made, _ = images(tmp_path / f"{name}.mcap")  # the last one has no duration
        assert len(made) >= 199
        assert made == images(SAMPLES / f"{name}.mcap")[: len(made)], name


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a run in which the hero brakes in time, and one in which it does not."""
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    folder = tmp_path_factory.mktemp("campaign") / "runs"
    done = run("campaign", f"{SAMPLES / 'campaign.py'}:follow", "--seeds", "3,4", "--out", folder, "--pages", "0")
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
