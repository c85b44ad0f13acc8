"""The documentation: its tables are complete, its code runs, and its commands print what it shows."""

from __future__ import annotations

import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click import Context

import carla_recap
from carla_recap import MissingExtra, SensorRig
from carla_recap.cli import cli
from carla_recap.model.records import NO_ACTOR
from tests.cli.command import printed
from tests.replay.scripts import pose, spawn, write
from tests.samples import ROOT
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator

    import griffe

PACKAGE = Path(carla_recap.__file__).parent
PAGES = [ROOT / "README.md", ROOT / "samples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXTS = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
FILES = {
    "run.mcap": "crash.mcap",
    "run.log": "crossing.log",
    "runs/crash.mcap": "crash.mcap",
    "rules.toml": "rules.toml",
    "recordings/FollowLeadingVehicle_1.log": "crossing.log",
}
NOT_RUN = re.compile(
    r"carla-recap (?:"
    r"(?:serve|view|watch|capture)\b"  # until they are ended, or with another server
    r"|video\b"  # takes long: see tests/show/video
    r"|.* --(?:serve|dask)\b"
    r")"
)
"""Commands of which only the options are checked."""


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text("utf-8"), re.DOTALL | re.MULTILINE)


# --- contents ---------------------------------------------------------------------------------------


def test_the_table_of_calls_is_up_to_date():
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    script = runpy.run_path(str(ROOT / "tools" / "make-calls"))
    assert script["PAGE"].read_text("utf-8") == script["page"](), "run tools/make-calls"


def test_the_tables_that_are_made_of_those_in_the_code_are_up_to_date():
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    for path, text in runpy.run_path(str(ROOT / "tools" / "make-tables"))["pages"]().items():
        assert path.read_text("utf-8") == text, "run tools/make-tables"


def test_the_rig_on_the_page_is_one():
    (rig,) = blocks(ROOT / "docs" / "sensors.md", "json")
    assert [sensor.id for sensor in SensorRig.of(json.loads(rig))] == ["front", "top"]


def test_the_docs_list_every_command_and_every_extra():
    command_line = (ROOT / "docs" / "command-line.md").read_text("utf-8")
    assert set(re.findall(r"^\| `carla-recap (\w+)", command_line, re.MULTILINE)) == set(cli.list_commands(Context(cli)))
    requirements = (ROOT / "docs" / "installing.md").read_text("utf-8")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert {name for name in extras if f"`{name}`" not in requirements} == {"dev"}


def anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files_and_headings(page):
    for link in re.findall(r"\]\(([^):]+)\)", page.read_text("utf-8")):
        name, _, heading = re.sub(r"\s", "", link).partition("#")
        target = page.parent / name if name else page
        assert target.exists(), link
        assert not heading or heading in anchors(target), link


def test_every_public_name_is_in_the_reference():
    reference = (ROOT / "docs" / "reference.md").read_text("utf-8")
    sections = dict(part.split("\n", 1) for part in re.split("^## ", reference, flags=re.MULTILINE)[1:])
    tables = {
        heading.strip("`"): re.findall(r"`([\w.]+)`", " ".join(re.findall(r"^\| (`.*`) \| \w.* \|$", text, re.MULTILINE)))
        for heading, text in sections.items()
    }
    for name in ("Recording", "Batch"):
        members = {member for member in dir(getattr(carla_recap, name)) if not member.startswith("_")}
        assert set(tables.pop(name)) == members
    simulator, others = tables.pop("Simulator"), tables.pop("Other packages")
    assert sorted(name for names in tables.values() for name in names) == sorted(carla_recap.__all__)
    assert sorted(simulator) == sorted(import_module("carla_recap.sim").__all__)
    for path in others:
        package, _, name = path.rpartition(".")
        with suppress(MissingExtra):
            assert name in import_module(package).__all__


def test_every_public_attribute_has_a_docstring():
    """Attributes of the classes in the reference: a docstring of their own, or a line of that of their class."""
    griffe = pytest.importorskip("griffe", reason="mkdocstrings is not installed")
    package = griffe.load("carla_recap", search_paths=[ROOT / "src"], docstring_parser="google")
    missing = []
    for name in [*carla_recap.__all__, *(f"sim.{name}" for name in import_module("carla_recap.sim").__all__)]:
        found = package[name]
        found = found.final_target if found.is_alias else found
        assert found.docstring, name
        if found.is_class and not {"IntEnum", "StrEnum"} & {str(base) for base in found.bases}:
            members = [member for key, member in found.all_members.items() if not key.startswith("_") and key != "args"]
            listed = documented(found)
            missing += [f"{name}.{member.name}" for member in members if not (member.docstring or member.name in listed)]
    assert not missing


def documented(found: griffe.Class) -> set[str]:
    """Return the names in the sections Attributes and Args of the docstrings of a class and its bases."""
    texts = [each.docstring.value for each in (found, *found.mro()) if each.docstring]
    lines = re.findall(r"^ +(\w+(?:, \w+)*): ", "\n".join(texts), re.MULTILINE)
    return {name for line in lines for name in line.split(", ")}


# --- examples ------------------------------------------------------------------------------------------


@pytest.fixture
def working_directory(tmp_path, monkeypatch):
    """A working directory with the samples, and with files of the names that pages use for those of a reader."""
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    (tmp_path / "maps").mkdir()
    for name, source in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).symlink_to(ROOT / "samples" / source)
    scraping(tmp_path / "scraping.log")
    (metric,) = blocks(ROOT / "docs" / "scenario-runner.md", "py")
    (tmp_path / "my_metric.py").write_text(metric, "utf-8")
    (tmp_path / "criteria.json").write_text("{}", "utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scraping(path: Path) -> None:
    """Write a recording in which a car scrapes along a barrier, and another car with a collision sensor hits it."""
    touched = {number: [(1, NO_ACTOR)] for number in (20, 21, 24, 25, 40)} | {
        56: [(1, 2), (2, 1)],
        57: [(2, 1)],
        58: [(1, 2)],
    }
    frames: list[dict[str, Any]] = [
        {
            "transforms": [pose(1, 100 * number), pose(2, 6000)],
            "collisions": [(0, *pair, pair[0] == 1, False) for pair in touched.get(number, [])],
        }
        for number in range(101)
    ]
    frames[0]["spawned"] = [spawn(1, "vehicle.tesla.model3", role_name="hero"), spawn(2)]
    write(path, frames, tick=0.05, date=1_767_261_600)


def snippets() -> list[object]:
    """Return the snippets of all pages, and what is shown below each."""
    pattern = re.compile(r"^```python\n(.*?)^```(?:\n\n```text\n(.*?)^```)?", re.DOTALL | re.MULTILINE)
    return [
        pytest.param(code, shown, id=f"{page.name}-{number}")
        for page in PAGES
        for number, (code, shown) in enumerate(pattern.findall(page.read_text("utf-8")), 1)
    ]


@pytest.mark.parametrize(("code", "shown"), snippets())
def test_a_snippet_runs_and_prints_what_is_shown(working_directory, capsys, code, shown):
    try:
        exec(compile(code, "snippet", "exec"), {"__name__": "snippet"})
    except MissingExtra as error:
        pytest.skip(str(error))
    except ModuleNotFoundError as error:
        if error.name not in ("carla", "matplotlib"):
            raise
        pytest.skip(f"{error.name} is not installed")
    assert shown in ("", capsys.readouterr().out)


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if "$ carla-recap" in page.read_text("utf-8")],
    ids=lambda page: str(page.relative_to(ROOT)),
)
def test_commands_print_what_is_shown(working_directory, page):
    """The commands of a page that use samples, or files that other commands have made of them, one after another."""
    for command, shown in commands(page):
        if NOT_RUN.match(command):
            continue
        if "samples/" in command or any((working_directory / word).exists() for word in command.split()):
            code, printed = run(command)
            if code == 2 and re.match(r"carla-recap: carla-recap \w+ needs ", printed):
                continue  # an extra is not installed
            assert code in (0, 1), (command, printed)
            assert not shown or lines(printed) == lines(shown), command


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_have_options_that_exist(working_directory, page):
    """All commands of a page, also those that are not run."""
    for arguments in invocations(page):
        command = cli.get_command(Context(cli), arguments[0])
        assert command is not None, arguments
        command.make_context(arguments[0], arguments[1:])


def invocations(page: Path) -> Iterator[list[str]]:
    """Yield the arguments of each `carla-recap` in the shell commands of a page."""
    shown = [line[2:] for line in "".join(blocks(page, "console")).splitlines() if line.startswith("$ ")]
    for line in shown + "".join(blocks(page, "sh")).splitlines():
        for part in re.split(r"\|+|&&?|;(?=(?:[^']*'[^']*')*[^']*$)", re.sub(r"\s#.*", "", line)):
            if part.strip().startswith("carla-recap "):
                yield shlex.split(part)[1:]


def test_the_rules_of_a_page_can_be_loaded(tmp_path):
    counts = []
    for rules in blocks(ROOT / "docs" / "ci.md", "toml"):
        (tmp_path / "rules.toml").write_text(rules, "utf-8")
        shutil.copy(ROOT / "samples" / "own_rules.py", tmp_path)
        counts.append(len(carla_recap.load_rules(tmp_path / "rules.toml").rules))
    assert counts == [2, 1, 3, 4, 2, 3, 1]


def test_a_question_about_parquet_files_is_answered(working_directory):
    duckdb = pytest.importorskip("duckdb", reason="the extra `sql` is not installed")
    (question,) = blocks(ROOT / "docs" / "tables.md", "sql")
    with carla_recap.open_recording("samples/crossing.log") as recording:
        carla_recap.export_parquet(recording, "crossing")
    with duckdb.connect() as connection:
        assert connection.sql(question).fetchall()


def commands(page: Path) -> list[tuple[str, str]]:
    """Return the commands, and the output that is shown for each."""
    return re.findall(r"^\$ (carla-recap .*)\n((?:(?!\$ ).*\n)*)", "".join(blocks(page, "console")), re.MULTILINE)


def run(command: str) -> tuple[int, str]:
    """Run a command in a shell, if it has more than words; return its exit code and what it prints."""
    if not re.search(r"[|&;<>$`#~*?]", re.sub(r"'[^']*'", "", command)):
        return printed(*shlex.split(command)[1:])
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "TZ": "UTC"}
    done = subprocess.run(
        command, shell=True, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=PATIENCE, check=False
    )
    return done.returncode, done.stdout.decode()


def lines(text: str) -> list[str]:
    """Return lines without the sizes of files, which differ a little between versions of compressors."""
    return [re.sub(r"\b\d+(\.\d)? (bytes|kB|MB)$", "SIZE", line.rstrip()) for line in text.splitlines()]
