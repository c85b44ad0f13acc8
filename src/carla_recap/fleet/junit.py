"""Verdicts as JUnit XML, for what shows the results of tests: GitLab, Jenkins, GitHub by an action.

A recording is a class of tests, and a rule is a test. GitLab groups by the class and takes the first of two tests with
one name; both are unique here, as each recording is listed once.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from carla_recap.errors import RecapError
from carla_recap.util.files import WholeFile, prepare_file, writing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.fleet.check import CheckedRecording
    from carla_recap.rules.rule_sets import Verdict

SUITE: Final = "carla-recap check"
_HEAD: Final = re.compile(rb"(\xef\xbb\xbf)?\s*(<\?xml|<testsuite|$)")  # some tools write no declaration
_UNPRINTABLE: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # what XML 1.0 cannot contain


def prepare_junit(path: Path | str) -> None:
    """Raise `RecapError` if a file of verdicts cannot be written, or is there and is no XML.

    A file of verdicts that is there is replaced, as by all that write JUnit XML.
    """
    prepare_file(path)
    head = b""
    if Path(path).exists():
        with writing(path), Path(path).open("rb") as file:
            head = file.read(100)
    if not _HEAD.match(head):
        raise RecapError(f"{path}: is there, and is no XML; expected another name")


def write_junit(checked: Sequence[CheckedRecording], path: Path | str, *, suite: str = SUITE) -> None:
    """Write the verdicts on recordings as JUnit XML; the file appears when it is complete.

    Args:
        checked: The recordings and the verdicts on them.
        path: The file.
        suite: The name of the suite.

    Raises:
        RecapError: The file cannot be written.
    """
    content = junit(checked, suite=suite)
    with WholeFile(path) as file:
        file.write(content)


def junit(checked: Sequence[CheckedRecording], *, suite: str = SUITE) -> bytes:
    """Return the verdicts on recordings as JUnit XML; see `write_junit`."""
    verdicts = [verdict for each in checked for verdict in each.verdicts]
    counts = {
        "tests": str(len(verdicts)),
        "failures": str(sum(verdict.status == "fail" for verdict in verdicts)),
        "errors": str(sum(verdict.status == "error" for verdict in verdicts)),
        "skipped": "0",
        "time": _seconds(sum(verdict.seconds for verdict in verdicts)),
    }
    root = Element("testsuites", {"name": suite, **counts})
    tests = SubElement(root, "testsuite", {"name": suite, **counts})
    for each in checked:
        for verdict in each.verdicts:
            _add(tests, each, verdict)
    indent(root)
    content: bytes = tostring(root, "utf-8", xml_declaration=True)
    return content + b"\n"


def how_to_see(recording: str, verdict: Verdict) -> str:
    """Return the command that shows the first offence of a verdict."""
    if verdict.time is None:
        return f"carla-recap view {shlex.quote(recording)}"
    return f"carla-recap view {shlex.quote(f'{recording}#t={verdict.time:.2f}')}"


def _add(suite: Element, checked: CheckedRecording, verdict: Verdict) -> None:
    names = {"classname": _clean(checked.recording), "name": _clean(verdict.rule)}
    case = SubElement(suite, "testcase", {**names, "time": _seconds(verdict.seconds)})
    if verdict.status == "pass":
        remarks = checked.warnings if verdict.applies else (verdict.message, *checked.warnings)
        if remarks:
            SubElement(case, "system-out").text = _clean("\n".join(remarks))
        return
    tag, kind = ("failure", "rule") if verdict.status == "fail" else ("error", "recording")
    lines = [verdict.message, *verdict.details]
    if verdict.actors:
        lines.append(f"actors: {', '.join(map(str, verdict.actors))}")
    if verdict.status == "fail":
        lines.append(f"to see it: {how_to_see(checked.recording, verdict)}")
        lines += [f"{name}: {path}" for name, path in (("page", checked.page), ("clip", checked.clip)) if path]
    SubElement(case, tag, {"message": _clean(verdict.message), "type": kind}).text = _clean("\n".join(lines))


def _seconds(time: float) -> str:
    return f"{time:.3f}"


def _clean(text: str) -> str:
    """Return a text without the characters that XML cannot contain."""
    return _UNPRINTABLE.sub("\ufffd", text)
