"""Verdicts as JUnit XML."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from carla_recap.fleet.check import CheckedRecording
from carla_recap.fleet.junit import prepare_junit, write_junit
from carla_recap.rules.rule_sets import Verdict

DETAILS = ("12.10 s: a hits b", "15.10 s: a hits c")
IDLE = Verdict("calm", "pass", "nothing to judge", applies=False)
CHECKED = [
    CheckedRecording(
        "runs/my run.mcap",
        (
            Verdict("no-collision", "fail", "2 collisions", 12.1, (41, 44), DETAILS, seconds=1.25),
            Verdict("complete", "pass", "the recording has 60 s", seconds=0.001),
        ),
        page="pages/my run.html",
    ),
    CheckedRecording("cut.mcap", (Verdict("complete", "pass", "it has 60 s"), IDLE), warnings=("it is cut short",)),
    CheckedRecording("runs/broken.mcap", (Verdict("no-collision", "error", "not a recording"),)),
]
EXPECTED = """\
<?xml version='1.0' encoding='utf-8'?>
<testsuites name="a suite" tests="5" failures="1" errors="1" skipped="0" time="1.251">
  <testsuite name="a suite" tests="5" failures="1" errors="1" skipped="0" time="1.251">
    <testcase classname="runs/my run.mcap" name="no-collision" time="1.250">
      <failure message="2 collisions" type="rule">2 collisions
12.10 s: a hits b
15.10 s: a hits c
actors: 41, 44
to see it: carla-recap view 'runs/my run.mcap#t=12.10'
page: pages/my run.html</failure>
    </testcase>
    <testcase classname="runs/my run.mcap" name="complete" time="0.001" />
    <testcase classname="cut.mcap" name="complete" time="0.000">
      <system-out>it is cut short</system-out>
    </testcase>
    <testcase classname="cut.mcap" name="calm" time="0.000">
      <system-out>nothing to judge
it is cut short</system-out>
    </testcase>
    <testcase classname="runs/broken.mcap" name="no-collision" time="0.000">
      <error message="not a recording" type="recording">not a recording</error>
    </testcase>
  </testsuite>
</testsuites>
"""


def test_a_recording_is_a_class_and_a_rule_is_a_test(tmp_path):
    write_junit(CHECKED, tmp_path / "out.xml", suite="a suite")
    assert (tmp_path / "out.xml").read_text() == EXPECTED


@pytest.mark.parametrize("there", [b"", b"<?xml version='1.0'?>", b"\xef\xbb\xbf<?xml", b"\n<testsuites/>"])
def test_a_file_of_verdicts_is_replaced_whoever_wrote_it(there, tmp_path):
    (tmp_path / "out.xml").write_bytes(there)
    prepare_junit(tmp_path / "out.xml")


def test_what_xml_cannot_contain_is_replaced(tmp_path):
    name = 'a\0b\x1b[31mc\ud800\ufffe<&"]]>é'
    verdict = Verdict(name, "fail", name, details=(name,))
    write_junit([CheckedRecording(name, (verdict,))], tmp_path / "out.xml")
    cleaned = 'a�b�[31mc��<&"]]>é'
    case = ElementTree.parse(tmp_path / "out.xml").find(".//testcase")
    assert (case.get("classname"), case.get("name"), case[0].get("message")) == (cleaned, cleaned, cleaned)
    assert case[0].text.startswith(f"{cleaned}\n{cleaned}\n")
