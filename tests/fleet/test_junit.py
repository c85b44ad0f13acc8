from __future__ import annotations

from xml.etree import ElementTree

import pytest

from carla_recap.errors import RecapError
from carla_recap.fleet.check import CheckedRecording
from carla_recap.fleet.junit import junit, prepare_junit, write_junit
from carla_recap.rules.rule_sets import Verdict
from tests.samples import names_in

CHECKED = [
    CheckedRecording(
        "runs/my run.mcap",
        (
            Verdict("no-collision", "fail", "2 collisions", 12.1, (41, 44), ("12.10 s: a hits b", "15.10 s: a hits c")),
            Verdict("complete", "pass", "the recording has 60 s"),
        ),
        page="pages/my run.html",
    ),
    CheckedRecording("runs/broken.mcap", (Verdict("no-collision", "error", "not a recording"),)),
]


def test_a_recording_is_a_class_and_a_rule_is_a_test():
    suites = ElementTree.fromstring(junit(CHECKED))
    (suite,) = suites
    for each in (suites, suite):
        assert {name: each.get(name) for name in ("tests", "failures", "errors", "skipped")} == {
            "tests": "3",
            "failures": "1",
            "errors": "1",
            "skipped": "0",
        }
    cases = [(case.get("classname"), case.get("name"), [child.tag for child in case]) for case in suite]
    assert cases == [
        ("runs/my run.mcap", "no-collision", ["failure"]),
        ("runs/my run.mcap", "complete", []),
        ("runs/broken.mcap", "no-collision", ["error"]),
    ]


@pytest.mark.parametrize(("applies", "warnings"), [(False, ()), (True, ("it is cut short",))])
def test_what_had_nothing_to_judge_and_warnings_are_in_the_output_of_a_test_that_passes(applies, warnings):
    verdict = Verdict("calm", "pass", "nothing to judge: it has no tram", applies=applies)
    (case,) = ElementTree.fromstring(junit([CheckedRecording("a.log", (verdict,), warnings=warnings)])).iter("testcase")
    assert [(child.tag, child.text) for child in case] == [("system-out", *(warnings or (verdict.message,)))]


@pytest.mark.parametrize("there", [b"", b"<?xml version='1.0'?>", b"\xef\xbb\xbf<?xml", b"\n<testsuites/>"])
def test_a_file_of_verdicts_is_replaced_whoever_wrote_it(there, tmp_path):
    (tmp_path / "out.xml").write_bytes(there)
    prepare_junit(tmp_path / "out.xml")


def test_times_are_those_of_the_judging():
    verdicts = (Verdict("quick", "pass", "", seconds=0.001), Verdict("slow", "fail", "", seconds=1.25))
    suites = ElementTree.fromstring(junit([CheckedRecording("a.log", verdicts), CheckedRecording("b.log", verdicts)]))
    assert [case.get("time") for case in suites.iter("testcase")] == ["0.001", "1.250"] * 2
    assert suites.get("time") == suites[0].get("time") == "2.502"


def test_a_failure_has_what_happened_and_how_to_see_it():
    failure = ElementTree.fromstring(junit(CHECKED)).find(".//failure")
    assert failure.get("message") == "2 collisions"
    assert failure.text.splitlines() == [
        "2 collisions",
        "12.10 s: a hits b",
        "15.10 s: a hits c",
        "actors: 41, 44",
        "to see it: carla-recap view 'runs/my run.mcap#t=12.10'",
        "page: pages/my run.html",
    ]


def test_what_xml_cannot_contain_is_replaced():
    name = 'a\0b\x1b[31mc\ud800\ufffe<&"]]>é'
    root = ElementTree.fromstring(junit([CheckedRecording(name, (Verdict(name, "fail", name, details=(name,)),))]))
    cleaned = 'a�b�[31mc��<&"]]>é'
    case = root.find(".//testcase")
    assert (case.get("classname"), case.get("name"), case[0].get("message")) == (cleaned, cleaned, cleaned)
    assert case[0].text.startswith(f"{cleaned}\n{cleaned}\n")


def test_the_file_appears_when_it_is_complete(tmp_path):
    write_junit(CHECKED, tmp_path / "out.xml")
    assert ElementTree.parse(tmp_path / "out.xml").getroot().tag == "testsuites"
    assert names_in(tmp_path) == ["out.xml"]
    with pytest.raises(RecapError, match="is a file; a folder was expected"):
        write_junit(CHECKED, tmp_path / "out.xml" / "out.xml")
