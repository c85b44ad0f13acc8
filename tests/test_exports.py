"""The formats of exports: each row of the table works from Python and from the command line, and is in the documentation."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner

from carla_recap import MissingExtra, RecapError, export, open_recording
from carla_recap.cli import cli
from carla_recap.exports import FORMATS, ExportFormat, find_format
from carla_recap.util.files import AtomicFile
from tests.samples import ROOT
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from pathlib import Path

CROSSING = ROOT / "samples" / "crossing.log"
PACKAGES = {
    "rerun": "rerun",
    "foxglove": "foxglove_schemas_protobuf",
    "arrow": "pyarrow",
    "osi": "betterosi",
    "cameras": "PIL",
    "ros": "rosbags",
}
RIG = ROOT / "samples" / "rigs" / "front_camera.json"

every_format = pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS)


@every_format
@pytest.mark.filterwarnings("ignore:.*the map Crossing is not found")
def test_a_recording_is_exported(request: pytest.FixtureRequest, tmp_path: Path, form: ExportFormat) -> None:
    destination = tmp_path / f"out{form.suffix}"
    if form.extra:
        pytest.importorskip(PACKAGES[form.extra], reason=f"the extra {form.extra} is not installed")
    part: dict[str, Any] = {"start": 20, "duration": 1} if "start" in form.options else {}
    if form.dataset:
        request.getfixturevalue("driver")
        part |= {"rig": RIG, "actor": 100, "rate": 10, "quality": "low"}
    with open_recording(CROSSING) as recording:
        done = export(recording, destination, to=form.name, **part)
        with pytest.raises(RecapError, match=r"exists already|is not empty"):
            export(recording, destination, to=form.name, **part)
        with pytest.raises(RecapError, match=f"wings does not go with an export to {form.name}"):
            export(recording, destination, to=form.name, force=True, wings=2)
    assert done.frames == (11 if part else 531)
    if done.files is None:
        assert destination.stat().st_size > 0
    else:
        assert sorted(done.files) == sorted(path for path in destination.rglob("*") if path.is_file())


@pytest.mark.parametrize("form", [form for form in FORMATS.values() if form.suffix], ids=lambda form: form.name)
@pytest.mark.filterwarnings("ignore:.*the map Crossing is not found")
def test_a_file_made_meanwhile_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: ExportFormat) -> None:
    if form.extra:
        pytest.importorskip(PACKAGES[form.extra], reason=f"the extra {form.extra} is not installed")
    path, move = tmp_path / f"out{form.suffix}", AtomicFile._move

    def moved(file: AtomicFile) -> None:
        path.write_bytes(b"mine")
        move(file)

    monkeypatch.setattr(AtomicFile, "_move", moved)
    part: dict[str, Any] = {"start": 20, "duration": 1} if "start" in form.options else {}
    with open_recording(CROSSING) as recording, pytest.raises(RecapError, match=r"cannot be written: File exists$"):
        export(recording, path, to=form.name, **part)
    assert path.read_bytes() == b"mine"


@every_format
def test_a_suffix_means_the_first_format_that_has_it(form: ExportFormat) -> None:
    if form.suffix:
        first = next(each for each in FORMATS.values() if each.suffix == form.suffix)
        assert find_format(f"a/b{form.suffix.upper()}") is first
    assert find_format(f"a/b{form.suffix}", form.name) is form
    assert find_format("a", form.name, is_folder=True) is form


def test_another_format_is_an_error() -> None:
    suffixes = {form.suffix for form in FORMATS.values()} - {""}
    with pytest.raises(RecapError, match=r"'a\.txt' does not end in ") as caught:
        find_format("a.txt")
    assert all(suffix in str(caught.value) for suffix in suffixes)
    with pytest.raises(RecapError, match=f"expected a format of exports, one of {', '.join(FORMATS)}, found 'wings'"):
        find_format("a.txt", "wings")
    with pytest.raises(RecapError, match=r"'a\.txt' does not end in \.rrd"):
        find_format("a.txt", "rerun")


@pytest.mark.parametrize("form", [form for form in FORMATS.values() if form.extra], ids=lambda form: form.name)
def test_a_missing_extra_is_named(tmp_path: Path, form: ExportFormat) -> None:
    options = {"rig": str(RIG), "actor": 100} if form.dataset else {}
    code = f"""
import sys
sys.modules[{PACKAGES[form.extra]!r}] = None
import carla_recap
with carla_recap.open_recording({str(CROSSING)!r}) as recording:
    try:
        carla_recap.export(recording, {str(tmp_path / f"out{form.suffix}")!r}, to={form.name!r}, **{options})
    except carla_recap.MissingExtra as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert done.stdout.strip() == str(MissingExtra(f"an export to {form.name}", form.extra))
    assert list(tmp_path.iterdir()) == []


@every_format
def test_a_format_is_in_the_help_of_the_command(form: ExportFormat) -> None:
    words = CliRunner().invoke(cli, ["export", "--help"]).output
    assert re.search(rf"^  {form.name} +{re.escape(form.suffix) or 'folder'} +{re.escape(form.text)}$", words, re.MULTILINE)


def test_the_documentation_lists_the_formats() -> None:
    page = (ROOT / "docs" / "exchange.md").read_text("utf-8")
    rows = [
        f"| `{form.name}` | {f'`{form.suffix}`' if form.suffix else 'folder'} | {form.text} |"
        f"{f' `{form.extra}`' if form.extra else ''} |\n"
        for form in FORMATS.values()
    ]
    assert f"\n| format | file | content | extra |\n|---|---|---|---|\n{''.join(rows)}\n" in page
