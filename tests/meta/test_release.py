"""What a release consists of: one version, workflows and forms that name what exists, the image of the server, the demo."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from typing import Any

import pytest
from click import Context

from carla_recap.cli import cli
from tests.samples import ROOT

GITHUB = ROOT / ".github"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
MAKEFILE = (ROOT / "Makefile").read_text("utf-8")
TARGETS = set(re.findall(r"^([a-z-]+):", MAKEFILE, re.MULTILINE))


def parsed(text: str) -> Any:
    return pytest.importorskip("yaml", reason="PyYAML is not installed").safe_load(text)


def text_of(*names: str) -> str:
    return ROOT.joinpath(*names).read_text("utf-8")


def test_the_version_is_the_same_everywhere():
    versions = re.findall(r"^## ([\d.]+)$", text_of("CHANGELOG.md"), re.MULTILINE)
    assert versions[0] == PROJECT["version"]
    assert parsed(text_of("CITATION.cff"))["version"] == PROJECT["version"]


@pytest.mark.parametrize("path", sorted(GITHUB.glob("workflows/*.yml")), ids=lambda path: path.stem)
def test_a_workflow_names_what_exists(path):
    text = path.read_text("utf-8")
    workflow = parsed(text)
    assert {"name", True, "permissions", "jobs"} <= set(workflow)  # YAML reads the key `on` as a truth value
    assert "://" not in text
    for job in workflow["jobs"].values():
        if "uses" in job:
            assert (ROOT / job["uses"]).is_file()
            continue
        assert job["timeout-minutes"]
        for step in job["steps"]:
            assert set(re.findall(r"\bmake ([a-z-]+)", step.get("run", ""))) <= TARGETS
            if step.get("run", "").startswith("."):
                assert (ROOT / step["run"]).is_file()
        needed = job.get("needs", [])
        assert {needed} if isinstance(needed, str) else set(needed) <= set(workflow["jobs"])
    assert all((ROOT / name).exists() for name in re.findall(r"docs/[\w.]+\.md|pyproject\.toml|\.ci/\w+", text))


def instructions(word: str) -> list[str]:
    """Return the arguments of an instruction of the Dockerfile, wherever it stands."""
    text = re.sub(r"\\\n\s*", " ", text_of("Dockerfile"))
    return re.findall(rf"^(?:HEALTHCHECK .*?)?{word} (.*)$", text, re.MULTILINE)


def is_sent(name: str) -> bool:
    """Return whether .dockerignore lets a file or folder of the repository into the build."""
    sent = True
    for line in text_of(".dockerignore").splitlines():
        if line and not line.startswith("#") and fnmatch(name, line.removeprefix("!").removeprefix("**/")):
            sent = line.startswith("!")
    return sent


def test_what_the_image_copies_exists_and_is_sent():
    copied = [name for line in instructions("COPY") if "--from" not in line for name in line.split()[:-1]]
    assert {"pyproject.toml", "LICENSE", "src"} <= set(copied)
    for name in copied:
        assert (ROOT / name).exists(), name
        assert is_sent(name), name
    assert not any(is_sent(name) for name in (".git", ".venv", "build", "tests", "__pycache__"))


def test_the_image_runs_the_server_on_the_ports_that_it_exposes():
    from carla_recap.cli.server import serve

    (entry,) = instructions("ENTRYPOINT")
    assert json.loads(entry)[0] in PROJECT["scripts"]
    words = json.loads(instructions("CMD")[-1])
    assert words[0] == "serve"
    values = serve.make_context("serve", words[1:]).params
    assert (values["host"], values["confine"]) == ("0.0.0.0", True)
    (exposed,) = instructions("EXPOSE")
    assert exposed.split() == [str(values["port"]), str(values["port"] + 1)]
    assert f"{values['port']}-{values['port'] + 1}:" in text_of("docs", "docker.md")


def test_the_health_check_asks_the_server():
    pytest.importorskip("carla", reason="the extra `carla` is not installed")
    pytest.importorskip("msgpack", reason="the extra `server` is not installed")
    from carla_recap.server import running

    program = json.loads(next(line for line in instructions("CMD") if line.startswith('["python"')))[-1]
    assert "2000" in program
    with running() as port:
        command = [sys.executable, "-c", program.replace("2000", str(port)).replace("(5)", "(60)")]
        assert subprocess.run(command, timeout=120, check=False).returncode == 0


def test_the_demo_installs_what_its_commands_need():
    (extras,) = re.findall(r"^demo_extras := ([\w,]+)$", MAKEFILE, re.MULTILINE)
    assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])
    lines = re.findall(r"^ *run carla-recap (.*)$", text_of("samples", "demo.sh"), re.MULTILINE)
    commands = [shlex.split(line.split(" || ")[0]) for line in lines]
    for words in commands:
        command = cli.get_command(Context(cli), words[0])
        assert command is not None, words
        known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        assert {word.split("=")[0] for word in words if word.startswith("--")} <= known, words
    assert {"record", "collisions", "replay", "report", "export", "video"} <= {words[0] for words in commands}
    assert not any(word.endswith(".rrd") for words in commands for word in words)
