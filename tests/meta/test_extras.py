"""The requirements of the extras, by Python and machine: CARLA's library is not published for all."""

from __future__ import annotations

import platform
import sys
import tomllib

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from carla_recap.errors import MissingExtra
from tests.samples import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
PYTHONS = ("3.11", "3.12", "3.13")
LINUX = {"sys_platform": "linux", "platform_machine": "x86_64", "platform_system": "Linux"}
ARM = LINUX | {"platform_machine": "aarch64"}
MAC = {"sys_platform": "darwin", "platform_machine": "arm64", "platform_system": "Darwin"}
WINDOWS = {"sys_platform": "win32", "platform_machine": "AMD64", "platform_system": "Windows"}


def asked_for(extra: str, python: str, machine: dict[str, str]) -> set[str]:
    """Return the packages that an extra installs, including those of the extras that it names."""
    environment = default_environment() | machine | {"python_version": python, "python_full_version": f"{python}.0"}
    found = set()
    for requirement in map(Requirement, EXTRAS[extra]):
        if requirement.marker is not None and not requirement.marker.evaluate(environment):
            continue
        if requirement.name == "carla-recap":
            for other in requirement.extras:
                found |= asked_for(other, python, machine)
        else:
            found.add(requirement.name)
    return found


@pytest.mark.parametrize("machine", [LINUX, ARM, MAC, WINDOWS], ids=["linux", "arm", "mac", "windows"])
@pytest.mark.parametrize("python", PYTHONS)
def test_carla_is_required_where_it_exists(python: str, machine: dict[str, str]) -> None:
    exists = python < "3.13" and machine in (LINUX, WINDOWS)
    for extra in ("carla", "all", "dev"):
        assert ("carla" in asked_for(extra, python, machine)) == exists
    assert asked_for("server", python, machine) >= {"pymunk", "msgpack"}
    assert asked_for("all", python, machine) >= {"pandas", "pyarrow", "rerun-sdk", "pymunk", "msgpack"}
    assert "carla" not in asked_for("server", python, machine) | asked_for("rerun", python, machine)


def test_the_versions_of_python() -> None:
    assert all(python in SpecifierSet(PROJECT["requires-python"]) for python in PYTHONS)
    named = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if "Python :: 3." in line]
    assert tuple(named) == PYTHONS


@pytest.mark.parametrize(("extra", "exists"), [("carla", False), ("server", True), ("sim", True), ("rerun", True)])
def test_an_extra_that_cannot_be_installed_is_not_suggested(
    monkeypatch: pytest.MonkeyPatch, extra: str, exists: bool
) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 13, 0))
    message = str(MissingExtra("a thing", extra))
    assert ("pip install" in message) == exists
    assert ("up to 3.12" in message) != exists
    monkeypatch.setattr(sys, "version_info", (3, 12, 0))
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    assert f"pip install '.[{extra}]'" in str(MissingExtra("a thing", extra))
