"""The formats of exports: each row of the table works from Python and from the command line, and is in the documentation."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from carla_recap import (
    MissingExtra,
    RecapError,
    Recording,
    SensorRig,
    clip,
    clips,
    convert,
    export,
    export_sensed,
    open_recording,
    recover,
    write_report,
)
from carla_recap.cli import cli
from carla_recap.exports import FORMATS, ExportFormat, find_format
from carla_recap.util.files import AtomicFile
from tests.replay.scripts import pose, spawn, write
from tests.samples import CROSSING, ROOT, names_in
from tests.show.conftest import limited
from tests.show.page.conftest import WITHOUT_ROADS
from tests.waiting import PATIENCE

PACKAGES = {
    "rerun": "rerun",
    "foxglove": "foxglove_schemas_protobuf",
    "arrow": "pyarrow",
    "osi": "betterosi",
    "cameras": "PIL",
    "ros": "rosbags",
}
RIG = ROOT / "samples" / "rigs" / "front_camera.json"
SPEED = {"type": "sensor.speedometer", "id": "speed"}

every_format = pytest.mark.parametrize("form", FORMATS.values(), ids=FORMATS)


every_file = pytest.mark.parametrize("form", [form for form in FORMATS.values() if form.suffix], ids=lambda form: form.name)
pytestmark = pytest.mark.filterwarnings("ignore:.*the map Crossing is not found")


@pytest.fixture
def part(request: pytest.FixtureRequest, form: ExportFormat) -> dict[str, Any]:
    """Options of an export of a second, if the format has parts; skips the test if the format cannot be written here."""
    if form.extra:
        pytest.importorskip(PACKAGES[form.extra], reason=f"the extra {form.extra} is not installed")
    part: dict[str, Any] = {"start": 20, "duration": 1} if "start" in form.options else {}
    if form.dataset:
        request.getfixturevalue("driver")
        part |= {"rig": RIG, "actor": 100, "rate": 10, "quality": "low"}
    return part


@pytest.fixture(scope="module")
def recording() -> Iterator[Recording]:
    with open_recording(CROSSING) as recording:
        yield recording


@every_format
def test_a_recording_is_exported(tmp_path: Path, recording: Recording, form: ExportFormat, part: dict[str, Any]) -> None:
    destination, seen = tmp_path / f"out{form.suffix}", []

    def progress(scenes: Any, _: object) -> Any:
        for scene in scenes:
            seen.extend([scene] * (len(scene) if form.name == "parquet" else 1))
            yield scene

    done = export(recording, destination, to=form.name, progress=progress, **part)
    assert done.frames == len(seen) == (11 if part else 531)
    with pytest.raises(RecapError, match=r"exists already|is not empty"):
        export(recording, destination, to=form.name, **part)
    with pytest.raises(RecapError, match=f"wings does not go with an export to {form.name}"):
        export(recording, destination, to=form.name, force=True, wings=2)
    if done.files is None:
        assert destination.stat().st_size > 0
    else:
        assert sorted(done.files) == sorted(path for path in destination.rglob("*") if path.is_file())
        (destination / "mine.txt").write_text("mine")
    assert export(recording, destination, to=form.name, force=True, **part).frames == done.frames
    assert done.files is None or (destination / "mine.txt").read_text() == "mine"


@every_format
def test_a_failure_leaves_nothing(tmp_path: Path, recording: Recording, form: ExportFormat, part: dict[str, Any]) -> None:
    def interrupted(scenes: Any, _: object) -> Any:
        yield next(iter(scenes))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(recording, tmp_path / f"out{form.suffix}", to=form.name, progress=interrupted, **part)
    assert list(tmp_path.iterdir()) == []


@every_format
def test_what_is_not_in_the_recording(
    tmp_path: Path, recording: Recording, form: ExportFormat, part: dict[str, Any]
) -> None:
    wrong: dict[str, tuple[Any, str]] = {
        "follow": (7, "no actor 7 to follow; known ids are"),
        "actor": (7, "no actor 7 to carry the rig; known ids are"),
        "start": (99, "nothing at 99 s; the recording ends at 53 s"),
    }
    for name in wrong.keys() & form.options:
        if name != "actor" or form.dataset:
            with pytest.raises(RecapError, match=wrong[name][1]):
                export(recording, tmp_path / f"out{form.suffix}", to=form.name, **part | {name: wrong[name][0]})
    assert list(tmp_path.iterdir()) == []


@every_format
def test_a_place_that_cannot_be_written(
    tmp_path: Path, recording: Recording, form: ExportFormat, part: dict[str, Any]
) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / f"folder{form.suffix}").mkdir()
    for place in (f"file/x{form.suffix}", f"folder{form.suffix}" if form.suffix else "file"):
        with pytest.raises(RecapError, match=r"cannot be written|is a file"):
            export(recording, tmp_path / place, to=form.name, force=True, **part)
    assert names_in(tmp_path) == ["file", f"folder{form.suffix}"]
    assert (tmp_path / "file").read_text() == "mine"


@every_format
@pytest.mark.filterwarnings("ignore::carla_recap.RecapWarning")
def test_odd_things_are_exported(tmp_path: Path, form: ExportFormat, part: dict[str, Any]) -> None:
    """Poses that are none, names that are not UTF-8, and an id that is used again."""
    xs = (0.0, math.nan, 3e38, math.inf, 100.0, 100.0)
    frames: list[dict[str, Any]] = [{"transforms": [pose(1, 100 * n), pose(2, x, 500, yaw=x)]} for n, x in enumerate(xs)]
    frames[0]["spawned"] = [spawn(1, role_name="hero"), spawn(2, "vehicle.\udcff", role_name="\udc80")]
    frames[4] |= {"destroyed": [2], "spawned": [spawn(2, "walker.\udcff")]}
    part |= {"start": 0, "duration": 0} if "start" in part else {}
    part |= {"actor": 1} if form.dataset else {}
    with open_recording(write(tmp_path / "odd.log", frames, tick=0.1)) as odd:
        assert export(odd, tmp_path / f"out{form.suffix}", to=form.name, **part).frames == len(frames)


@every_file
@pytest.mark.skipif(os.name != "posix", reason="there are no such limits")
def test_a_full_disk(tmp_path: Path, recording: Recording, form: ExportFormat, part: dict[str, Any]) -> None:
    path = tmp_path / f"out{form.suffix}"
    export(recording, path, to=form.name, **part)
    sizes = 0, 1_000, path.stat().st_size - 2_000
    path.unlink()
    code = (
        f"import carla_recap\nwith carla_recap.open_recording({str(CROSSING)!r}) as recording:\n"
        f"    carla_recap.export(recording, {str(path)!r}, to={form.name!r}, **{part})"
    )
    assert limited(code, *sizes) == [f"RecapError: {path}: cannot be written: File too large"] * 3
    assert list(tmp_path.iterdir()) == []


@every_file
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere names are text")
def test_a_name_that_is_not_utf8(tmp_path: Path, recording: Recording, form: ExportFormat, part: dict[str, Any]) -> None:
    for name in ("\udcff", "text"):
        export(recording, tmp_path / f"{name}{form.suffix}", to=form.name, **part)
    odd, text = ((tmp_path / f"{name}{form.suffix}").stat().st_size for name in ("\udcff", "text"))
    assert odd == pytest.approx(text, rel=0.01)


@every_file
def test_a_file_made_meanwhile_is_kept(
    tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch, form: ExportFormat, part: dict[str, Any]
) -> None:
    path, move = tmp_path / f"out{form.suffix}", AtomicFile._move

    def moved(file: AtomicFile) -> None:
        path.write_bytes(b"mine")
        move(file)

    monkeypatch.setattr(AtomicFile, "_move", moved)
    with pytest.raises(RecapError, match=r"cannot be written: File exists$"):
        export(recording, path, to=form.name, **part)
    assert path.read_bytes() == b"mine"


OTHERS: dict[str, tuple[str, Callable[..., object]]] = {
    "clip": (".log", lambda recording, path, **options: clip(recording.path, path, start=20, duration=1, **options)),
    "clips": ("", lambda recording, path, **options: clips(recording.path, path, rerun=False, **options)),
    "conversion": (".mcap", lambda recording, path, **options: convert(recording.path, path, **options)),
    "page": (".html", partial(write_report, options=WITHOUT_ROADS, pictures="none")),
    "page as a folder": ("", partial(write_report, options=WITHOUT_ROADS, pictures="none")),
    "recovery": (".log", lambda recording, path, **options: recover(recording.path, path, **options)),
    "sensed": (".mcap", partial(export_sensed, rig=SensorRig.of([SPEED]), start=20, duration=1)),
}
"""What is written beside exports: the suffix of files, and the function."""


@pytest.mark.parametrize("name", OTHERS)
def test_other_files_are_kept_and_appear_when_they_are_complete(tmp_path: Path, recording: Recording, name: str) -> None:
    def interrupted(found: Any, *_: object) -> Any:
        yield next(iter(found))
        raise KeyboardInterrupt

    suffix, function = OTHERS[name]
    path = tmp_path / f"out{suffix}"
    with pytest.raises(KeyboardInterrupt):
        function(recording, path, progress=interrupted)
    assert names_in(tmp_path) == []
    mine = path if suffix else path / "mine.txt"
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine")
    with pytest.raises(RecapError, match=r"exists already; --force|is not empty"):
        function(recording, path)
    assert mine.read_text() == "mine"
    function(recording, path, force=True)
    assert (mine.read_bytes() == b"mine") == (suffix == "")
    assert suffix or len(names_in(path)) > 2
    for place in (f"out{suffix}/x{suffix}", f"folder{suffix}") if suffix else ("out/mine.txt",):
        (tmp_path / f"folder{suffix}").mkdir(exist_ok=True)
        with pytest.raises(RecapError, match=r"cannot be written|is a file|is no file"):
            function(recording, tmp_path / place, force=True)


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


def test_missing_extras_are_named(tmp_path: Path) -> None:
    code = f"""
import sys
sys.modules |= dict.fromkeys({[*PACKAGES.values()]})
import carla_recap
from carla_recap.exports import FORMATS
with carla_recap.open_recording({str(CROSSING)!r}) as recording:
    for form in FORMATS.values():
        if form.extra:
            try:
                options = {{"rig": {str(RIG)!r}, "actor": 100}} if form.dataset else {{}}
                carla_recap.export(recording, f"{tmp_path}/out{{form.suffix}}", to=form.name, **options)
            except carla_recap.MissingExtra as error:
                print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=True)
    extras = [MissingExtra(f"an export to {form.name}", form.extra) for form in FORMATS.values() if form.extra]
    assert done.stdout.splitlines() == list(map(str, extras))
    assert list(tmp_path.iterdir()) == []


@every_format
def test_a_format_is_in_the_help_of_the_command(form: ExportFormat) -> None:
    words = CliRunner().invoke(cli, ["export", "--help"]).output
    assert re.search(rf"^  {form.name} +{re.escape(form.suffix) or 'folder'} +{re.escape(form.text)}$", words, re.MULTILINE)
