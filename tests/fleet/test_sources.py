from __future__ import annotations

import pytest

from carla_recap.errors import RecapError
from carla_recap.fleet.sources import find_sources, means_one


@pytest.fixture
def folder(tmp_path):
    for name in ("b.mcap", "a.log", "c.txt", ".hidden.log", "deep/d.LOG"):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"12345")
    return tmp_path


def names(sources, folder):
    return [str(source.location).removeprefix(f"{folder}/") for source in find_sources(sources)]


def test_a_folder_means_the_recordings_in_it_and_below(folder):
    assert names([folder], folder) == ["a.log", "b.mcap", "deep/d.LOG"]


def test_a_glob_means_what_it_matches(folder):
    assert names([f"{folder}/*.mcap", f"{folder}/**/*.LOG"], folder) == ["b.mcap", "deep/d.LOG"]


def test_a_recording_that_is_named_twice_is_found_once(folder):
    assert names([folder / "a.log", folder, folder / "c.txt"], folder) == ["a.log", "b.mcap", "deep/d.LOG", "c.txt"]


def test_sizes_and_times_are_those_of_the_files(folder):
    (found,) = find_sources([folder / "a.log"])
    assert (found.size, found.modified) == (5, (folder / "a.log").stat().st_mtime)


def test_a_file_that_is_missing_is_left_to_whatever_opens_it(folder):
    (found,) = find_sources([folder / "missing.log"])
    assert found.size is None


@pytest.mark.parametrize("source", ["*.json", "empty"])
def test_a_source_without_recordings_is_an_error(folder, source):
    (folder / "empty").mkdir()
    with pytest.raises(RecapError, match="no recordings"):
        list(find_sources([f"{folder}/{source}"]))


def test_a_source_without_recordings_can_be_a_row(folder):
    (found, other) = find_sources([folder / "*.json", folder / "a.log"], errors="yield")
    assert found.location == f"{folder}/*.json"
    assert "no recordings" in found.error
    assert other.error is None


def test_a_form_means_one_recording_or_many(folder):
    assert means_one(folder / "a.log")
    assert means_one(folder / "missing.log")
    assert not means_one(folder)
    assert not means_one(folder / "*.log")
