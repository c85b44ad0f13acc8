"""The command doctor."""

from __future__ import annotations

import json
import re
import shutil
import sys
from importlib.metadata import files

from click.testing import CliRunner

import carla_recap
import carla_recap.rendering.renderer
import carla_recap.roads.find
import carla_recap.util.cache
from carla_recap.cli.doctor import doctor as doctor_command
from tests.cli.command import ENVIRONMENT, before_others, run

BUILT_IN = "Brickfield"
NO_CACHE = {"folder": None, "entries": 0, "bytes": 0, "error": None}


def text(*options, **environment):
    """Return what the command prints in an environment."""
    done = CliRunner().invoke(doctor_command, options, env={name: str(value) for name, value in environment.items()})
    assert (done.exit_code, done.stderr) == (0, "")
    return done.stdout


def doctor(**environment):
    """Return the JSON of the command in an environment."""
    return json.loads(text("--json", **environment))


def in_a_new_process(*options, **environment):
    """Return what the command prints in an environment, in a process that has not drawn yet."""
    done = run("doctor", *options, env=ENVIRONMENT | {name: str(value) for name, value in environment.items()})
    assert (done.returncode, done.stderr) == (0, b"")
    return done.stdout.decode()


def test_versions_and_extras_are_those_of_the_packages():
    found = doctor()
    assert found["versions"]["carla-recap"] == carla_recap.__version__
    assert found["versions"]["python"] == ".".join(map(str, sys.version_info[:3]))
    assert {"pandas", "cameras", "server", "sql", "rerun"} <= set(found["extras"])
    assert not {"all", "dev"} & set(found["extras"])
    assert set(found["extras"]["cameras"]) == {"embreex", "moderngl", "pillow", "simplejpeg"}
    assert set(found["extras"]["server"]) >= {"pymunk", "msgpack"}


def test_what_is_missing_is_named_with_the_remedy(monkeypatch, tmp_path):
    """The metadata of this package are found, those of other packages are not; its modules are imported above."""
    metadata = next(file for file in files("carla-recap") if file.name == "METADATA").locate()
    shutil.copytree(metadata.parent, tmp_path / metadata.parent.name)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    found = doctor()
    assert found["extras"]["sql"] == {"duckdb": None, "pyarrow": None}
    assert found["versions"]["carla"] is None
    assert re.search(r"^  sql +missing: \w+, \w+; pip install '\.\[sql\]'$", text(), re.MULTILINE)


def test_the_cache_has_a_folder_and_a_size(tmp_path):
    (tmp_path / "a.town").write_bytes(bytes(1000))
    (tmp_path / "other").write_bytes(bytes(1000))
    found = {**NO_CACHE, "folder": str(tmp_path), "entries": 1, "bytes": 1000}
    assert doctor(CARLA_RECAP_CACHE=tmp_path)["cache"] == found
    assert doctor(CARLA_RECAP_CACHE="")["cache"] == NO_CACHE
    missing = tmp_path / "missing"
    assert doctor(CARLA_RECAP_CACHE=missing)["cache"] == {**NO_CACHE, "folder": str(missing)}


def test_without_a_driver_there_is_a_line_and_no_traceback(tmp_path):
    nowhere = tmp_path / "none.json"
    nowhere.write_text("{}")
    drawing = json.loads(in_a_new_process("--json", __EGL_VENDOR_LIBRARY_FILENAMES=nowhere))["drawing"]
    assert drawing["device"] is None
    assert "OpenGL cannot be used" in drawing["error"] or "needs" in drawing["error"]


def test_the_text_has_all_parts():
    lines = text().splitlines()
    assert [line for line in lines if not line.startswith(" ")] == ["Versions", "Drawing", "Extras", "Maps", "Cache"]
    assert any(line.split()[0] == BUILT_IN for line in lines)


def test_maps_are_listed_with_their_files(tmp_path):
    (tmp_path / "Somewhere.xodr").write_text("<OpenDRIVE/>")
    found = doctor(CARLA_RECAP_MAPS=tmp_path)["maps"]
    assert (found["folder"], found["files"]["Somewhere"]) == (str(tmp_path), str(tmp_path / "Somewhere.xodr"))


def test_files_in_place_of_folders_are_named(tmp_path):
    file = tmp_path / "file"
    file.touch()
    found = doctor(CARLA_RECAP_MAPS=file, CARLA_RECAP_CACHE=file)
    assert found["maps"] == {"folder": str(file), "files": {}, "error": "Not a directory"}
    assert found["cache"] == {**NO_CACHE, "folder": str(file), "error": "Not a directory"}
    assert f"\n  none           {file}: Not a directory\n" in text(CARLA_RECAP_MAPS=file, CARLA_RECAP_CACHE=file)


def test_a_broken_package_is_a_line(tmp_path):
    (tmp_path / "moderngl.py").write_text("raise OSError('libGL.so.1: cannot open')")
    drawing = json.loads(in_a_new_process("--json", PYTHONPATH=before_others(tmp_path)))["drawing"]
    assert drawing["device"] is None
    assert drawing["error"] == "OSError: libGL.so.1: cannot open"
