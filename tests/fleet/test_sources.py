from __future__ import annotations

import io
import os
import sys

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


@pytest.mark.parametrize(
    ("sources", "found"),
    [
        (("",), ["a.log", "b.mcap", "deep/d.LOG"]),  # a folder means the recordings in it and below
        (("/*.mcap", "/**/*.LOG"), ["b.mcap", "deep/d.LOG"]),
        (("/a.log", "", "/c.txt", "/deep/../a.log"), ["a.log", "b.mcap", "deep/d.LOG", "c.txt"]),  # each once
        (("/missing.log",), ["missing.log"]),  # is left to whatever opens it
    ],
)
@pytest.mark.parametrize("scheme", ["", "file://"])
def test_folders_globs_and_files_mean_recordings(folder, sources, found, scheme):
    assert names([f"{scheme}{folder}{source}" for source in sources], folder) == found


@pytest.mark.parametrize("source", ["", "/**/*.*"])
def test_linked_folders_are_searched_once(folder, source):
    (folder / "a-loop").symlink_to(folder)
    (folder / "deep" / "up").symlink_to(folder / "deep")
    (folder.with_name("beside")).mkdir(exist_ok=True)
    (folder.with_name("beside") / "e.log").touch()
    (folder / "linked").symlink_to(folder.with_name("beside"))
    (folder / "a-link.log").symlink_to(folder / "a.log")
    found = [name for name in names([f"{folder}{source}"], folder) if not name.endswith("txt")]
    assert sorted(found) == ["a-link.log", "a.log", "b.mcap", "deep/d.LOG", "linked/e.log"]


def test_a_link_that_leads_elsewhere_now_is_followed_anew(tmp_path):
    link = tmp_path / "link"
    for name, count in (("one", 1), ("other", 2)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.log").touch()
        link.unlink(missing_ok=True)
        link.symlink_to(tmp_path / name)
        assert len(list(find_sources([link, tmp_path / "one"]))) == count


@pytest.mark.parametrize("source", ["*.json", "empty"])
def test_a_source_without_recordings_is_an_error_or_a_row(folder, source):
    (folder / "empty").mkdir()
    with pytest.raises(RecapError, match="no recordings"):
        list(find_sources([folder / source]))
    found, other = find_sources([folder / source, folder / "a.log"], errors="yield")
    assert (found.location, other.error) == (f"{folder}/{source}", None)
    assert "no recordings" in found.error


def test_a_folder_that_cannot_be_listed_hides_no_recordings(folder, monkeypatch):
    listed = os.scandir

    def refuse(path):
        if str(path).endswith("deep"):
            raise PermissionError(13, "Permission denied", path)
        return listed(path)

    monkeypatch.setattr(os, "scandir", refuse)
    *found, missing = find_sources([folder], errors="yield")
    assert [source.error for source in found] == [None, None]
    assert missing.error == f"{folder}/deep: Permission denied"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("{}/a.log", True),
        ("{}/missing.log", True),
        ("file://{}/a.log", True),
        ("http://[::1]/a.mcap?x=*&y=[]", True),
        ("https://host/download/17", True),
        ("s3://runs/deep/a.LOG", True),
        ("{}", False),
        ("{}/*.log", False),
        ("file://{}/deep", False),
        ("s3://runs/*.mcap", False),
        ("s3://runs/deep/", False),
        ("gs://runs", False),
        ("-", False),
    ],
)
def test_a_form_means_one_recording_or_many(folder, source, expected):
    source = source.format(folder)
    assert means_one(source) == expected
    if expected:
        assert [found.location for found in find_sources([source, source])] == [source.removeprefix("file://")]


def test_a_list_on_stdin(folder, monkeypatch):
    lines = f"{folder}/b.mcap\n\n  \r\n{folder}/deep\r\n{folder}/b.mcap"
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(lines.encode())))
    assert names([folder / "c.txt", "-"], folder) == ["c.txt", "b.mcap", "deep/d.LOG"]


def test_an_empty_list_is_an_error(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"\n")))
    with pytest.raises(RecapError, match="stdin: no recordings"):
        list(find_sources(["-"], errors="yield"))


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("http://host/runs/*.mcap", "a web server does not list its files; name each file"),
        ("https://host/runs/", "a web server does not list"),
        ("http://[::1]/[ab].log", "a web server does not list"),
        ("ftp://host/a.log", "unknown kind of URL"),
        ("", "'': a path or a URL was expected"),
    ],
)
def test_what_means_nothing_is_an_error_or_a_row(source, message):
    with pytest.raises(RecapError) as caught:
        list(find_sources([source]))
    assert str(caught.value).startswith(source)
    assert message in str(caught.value)
    assert [found.error for found in find_sources([source, "a.log"], errors="yield")] == [str(caught.value), None]


@pytest.fixture(scope="module")
def bucket(tmp_path_factory):
    web = pytest.importorskip("tests.web", reason="the extra `remote` is not installed")
    folder = tmp_path_factory.mktemp("bucket")
    for name in (
        "top.mcap",
        "runs/b.mcap",
        "runs/a 1%20.log",
        "runs/c.txt",
        "runs/.hidden.log",
        "runs/deep/d.LOG",
        "runs2/e.log",
    ):
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_bytes(b"12345")
    with web.serve_bucket("bucket", folder) as url:
        yield url


LISTED = {
    "": ["runs/a 1%20.log", "runs/b.mcap", "runs/deep/d.LOG", "runs2/e.log", "top.mcap"],
    "/runs": ["runs/a 1%20.log", "runs/b.mcap", "runs/deep/d.LOG"],
    "/runs/": ["runs/a 1%20.log", "runs/b.mcap", "runs/deep/d.LOG"],
    "/runs/*": ["runs/a 1%20.log", "runs/b.mcap", "runs/c.txt", "runs/deep/d.LOG"],
    "/runs/*.mcap": ["runs/b.mcap"],
    "/runs/?.mcap": ["runs/b.mcap"],
    "/runs/[!a]*": ["runs/b.mcap", "runs/c.txt", "runs/deep/d.LOG"],
    "/**/*.log": ["runs/a 1%20.log", "runs2/e.log"],
    "/runs/**": ["runs/a 1%20.log", "runs/b.mcap", "runs/c.txt", "runs/deep/d.LOG"],
    "/*": ["runs/a 1%20.log", "runs/b.mcap", "runs/deep/d.LOG", "runs2/e.log", "top.mcap"],
    "/runs/.h*": ["runs/.hidden.log"],
}


@pytest.mark.parametrize("source", LISTED)
def test_prefixes_and_globs_of_buckets(bucket, source):
    assert names([bucket + source], bucket) == LISTED[source]


def test_sizes_times_and_etags_are_those_of_the_listing(bucket):
    (found,) = find_sources([f"{bucket}/runs/*.mcap"])
    assert found.size == 5
    assert found.modified > 1.6e9
    assert found.etag


@pytest.mark.parametrize("source", ["none/", "*.json", "runs/[z-a]*"])
def test_a_bucket_without_such_recordings(bucket, source):
    (found,) = find_sources([f"{bucket}/{source}"], errors="yield")
    assert found.error.startswith(f"{bucket}/{source}: ")


def test_a_bucket_that_does_not_exist(bucket):
    with pytest.raises(RecapError, match=r"^s3://other/runs/: no such bucket or prefix$"):
        list(find_sources(["s3://other/runs/"]))


@pytest.mark.parametrize("name", ["x" * 5000, "x" * 5000 + "*", "a\0b.log", "a\0*.log", "[", "nonsense://x"])
def test_a_name_that_no_file_has_is_an_error_or_a_row(name):
    (found,) = find_sources([name], errors="yield")
    assert found.location == name
    assert found.size is None
