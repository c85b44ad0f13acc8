"""Verdicts as JUnit XML, for what shows the results of tests: GitLab, Jenkins, GitHub by an action.

A recording is a class of tests, and a rule is a test. GitLab groups by the class and takes the first of two tests with
one name; both are unique here, as each recording is listed once.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from carla_recap.errors import RecapError
from carla_recap.util.files import WholeFile, prepare_file, writing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.fleet.check import CheckedRecording
    from carla_recap.rules.rule_sets import Verdict

_HEAD: Final = re.compile(rb"(\xef\xbb\xbf)?\s*(<\?xml|<testsuite|$)")  # some tools write no declaration
_UNPRINTABLE: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # what XML 1.0 cannot contain


def prepare_junit(path: Path | str) -> None:
    """Raise `RecapError` if a file of verdicts cannot be written, or is there and is no XML; XML is replaced."""
    prepare_file(path)
    if Path(path).exists():
        with writing(path), Path(path).open("rb") as file:
            if not _HEAD.match(file.read(100)):
                raise RecapError(f"{path}: is there, and is no XML; expected another name")


def write_junit(checked: Sequence[CheckedRecording], path: Path | str, *, suite: str = "carla-recap check") -> None:
    """Write the verdicts on recordings as JUnit XML, in a suite of tests with a name, or raise `RecapError`.

    The file appears when it is complete.
    """
    verdicts = [verdict for each in checked for verdict in each.verdicts]
    statuses = Counter(verdict.status for verdict in verdicts)
    seconds = sum(verdict.seconds for verdict in verdicts)
    counts = {"tests": len(verdicts), "failures": statuses["fail"], "errors": statuses["error"], "skipped": 0}
    about = {"name": suite, **{name: str(count) for name, count in counts.items()}, "time": f"{seconds:.3f}"}
    root = Element("testsuites", about)
    tests = SubElement(root, "testsuite", about)
    for each in checked:
        for verdict in each.verdicts:
            names = {"classname": _clean(each.recording), "name": _clean(verdict.rule), "time": f"{verdict.seconds:.3f}"}
            _add_result(SubElement(tests, "testcase", names), each, verdict)
    indent(root)
    content: bytes = tostring(root, "utf-8", xml_declaration=True)
    with WholeFile(path) as file:
        file.write(content + b"\n")


def _add_result(case: Element, checked: CheckedRecording, verdict: Verdict) -> None:
    """Add to a test what failed, or what is to be said of one that passes."""
    if verdict.status == "pass":
        lines = [*checked.warnings] if verdict.applies else [verdict.message, *checked.warnings]
        if lines:
            SubElement(case, "system-out").text = _clean("\n".join(lines))
        return
    lines = [verdict.message, *verdict.details]
    if verdict.actors:
        lines.append(f"actors: {', '.join(map(str, verdict.actors))}")
    if verdict.status == "fail":
        moment = "" if verdict.time is None else f"#t={verdict.time:.2f}"
        lines.append(f"to see it: carla-recap view {shlex.quote(checked.recording + moment)}")
        lines += [f"{name}: {path}" for name, path in (("page", checked.page), ("clip", checked.clip)) if path]
    tag, kind = ("failure", "rule") if verdict.status == "fail" else ("error", "recording")
    SubElement(case, tag, {"message": _clean(verdict.message), "type": kind}).text = _clean("\n".join(lines))


def _clean(text: str) -> str:
    """Return a text without the characters that XML cannot contain."""
    return _UNPRINTABLE.sub("\ufffd", text)
