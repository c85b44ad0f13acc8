"""Paths and URLs: which is which, and the times at their ends."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from carla_recap import FormatError, RecapError, open_recording
from carla_recap.formats.sources import LocalSource, TimeFragment, is_remote, path_of, split_time, unsigned
from tests.samples import save


@pytest.mark.parametrize(
    ("remote", "locations"),
    [
        (False, ["runs/a.mcap", "C:\\runs\\a.mcap", "s3:/a.mcap", "file:///a.mcap", Path("s3://a.mcap")]),
        (True, ["s3://b/a.mcap", "S3://b/a.mcap", "abfss://fs@account.dfs/a.mcap", "https://h/a.mcap"]),
    ],
)
def test_what_is_a_url(remote, locations):
    assert {is_remote(location) for location in locations} == {remote}


@pytest.mark.parametrize(
    ("location", "name"),
    [
        ("s3://b/x/a#1?.mcap", "a#1?.mcap"),
        ("https://h/x/a%201.mcap?key=/b.log#t", "a 1.mcap"),
        ("file:///x/a%201.log", "a 1.log"),
    ],
)
def test_the_name_of_a_url(location, name):
    assert path_of(location).name == name


def test_signatures_are_left_out_of_what_is_passed_on():
    assert unsigned("https://h/a.mcap?signature=secret") == "https://h/a.mcap"
    assert unsigned("s3://b/a?.mcap") == "s3://b/a?.mcap"
    assert unsigned("a?.mcap") == "a?.mcap"


@pytest.mark.parametrize(
    ("location", "expected"),
    [
        ("a.mcap", ("a.mcap", None)),
        ("a.mcap#t=12.5", ("a.mcap", TimeFragment(12.5, None))),
        ("a.mcap#t=npt:12", ("a.mcap", TimeFragment(12, None))),
        ("s3://b/a.mcap#t=12.5,20", ("s3://b/a.mcap", TimeFragment(12.5, 20))),
        ("http://h/a.mcap?x=1#t=0", ("http://h/a.mcap?x=1", TimeFragment(0, None))),
        ("a#t=1#t=2.mcap#t=3", ("a#t=1#t=2.mcap", TimeFragment(3, None))),
        ("a.mcap#t=", ("a.mcap#t=", None)),
        ("a.mcap#t=-1", ("a.mcap#t=-1", None)),
        ("a.mcap#t=1e9", ("a.mcap#t=1e9", None)),
        ("#t=1", ("#t=1", None)),
        ("a" * 5000 + "#t=1", ("a" * 5000 + "#t=1", None)),
        ("ftp://h/a#t=1", ("ftp://h/a", TimeFragment(1, None))),
    ],
)
def test_times_at_the_end(location, expected):
    assert split_time(location) == expected


def test_a_file_of_such_a_name_is_a_file(tmp_path, small):
    path = save(tmp_path / "a.log#t=1", small.read_bytes())
    assert split_time(str(path)) == (str(path), None)
    with open_recording(str(path)) as recording:
        assert recording.info.frames == 4


def test_errors_show_the_location_as_given():
    with pytest.raises(RecapError, match=r"^\./missing//a\.log: No such file"):
        open_recording("./missing//a.log")


def test_reads_that_come_short_are_not_the_end(tmp_path):
    class Short(io.FileIO):
        def read(self, size=-1):
            return super().read(min(size, 3) if size > 0 else size)

    path = tmp_path / "a.bin"
    path.write_bytes(bytes(range(100)))
    with Short(path) as file:
        assert LocalSource(path, file).read(10, 50, "the middle") == bytes(range(10, 60))
        with pytest.raises(FormatError):
            LocalSource(path, file).read(90, 11, "what is not there")
