"""The stored results of the benchmarks, in `results.json`: what the rows have measured, when, and on what machine."""

from __future__ import annotations

import json
import os
import platform
import subprocess
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmarks.measuring import Line

if TYPE_CHECKING:
    from collections.abc import Mapping

RESULTS: Final = Path(__file__).with_name("results.json")


@dataclass(frozen=True)
class Conditions:
    """When, with what version and on what machine a row was measured."""

    date: str
    commit: str
    machine: str
    python: str


@dataclass(frozen=True)
class Result:
    """What a row has measured: when and on what, and its lines of the table."""

    conditions: Conditions
    lines: tuple[Line, ...]


def load(path: Path = RESULTS) -> dict[str, Result]:
    """Return the results by the names of their rows."""
    if not path.exists():
        return {}
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))
    return {
        name: Result(
            Conditions(**{field.name: result[field.name] for field in fields(Conditions)}),
            tuple(Line(**line) for line in result["lines"]),
        )
        for name, result in found.items()
    }


def save(results: Mapping[str, Result], path: Path = RESULTS) -> None:
    """Write the results, a line of text for each of their lines."""
    rows = []
    for name, result in results.items():
        lines = ",\n".join(f"      {_json(asdict(line))}" for line in result.lines)
        rows.append(
            f'  {_json(name)}: {{\n    {_json(asdict(result.conditions))[1:-1]},\n    "lines": [\n{lines}\n    ]\n  }}'
        )
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text("{\n" + ",\n".join(rows) + "\n}\n", "utf-8")
    unfinished.replace(path)


def current_conditions() -> Conditions:
    """Return today's date, the commit of the sources, the processor and Python's version."""
    return Conditions(
        date=datetime.now(UTC).date().isoformat(),
        commit=_commit(),
        machine=f"{os.cpu_count()} cores of {_processor()}, {platform.system()}",
        python=platform.python_version(),
    )


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _commit() -> str:
    """Return the commit of the sources, with a plus sign if they have been changed since."""
    commit = _git("rev-parse", "--short", "HEAD")
    return f"{commit}+" if commit and _git("status", "--porcelain", "--", "src", "benchmarks/*.py") else commit


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(RESULTS.parents[1]), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(names), platform.processor() or platform.machine())
