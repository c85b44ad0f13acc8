"""Files and folders that appear when they are complete."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from errno import EINVAL, EIO, ENOSYS, EPERM
from pathlib import Path

import pytest

from carla_recap import Header, RecapError, create_recording, create_writer
from carla_recap.util import files
from carla_recap.util.files import WholeFile, check_folder, new_folder, partials, prepare_file
from tests.samples import names_in


@pytest.mark.parametrize("live", [False, True])
def test_a_file_appears_when_it_is_complete_and_a_live_one_has_all_bytes_before(tmp_path: Path, live: bool) -> None:
    path = tmp_path / "a.bin"
    with WholeFile(path, live=live) as file:
        file.write(b"12")
        (partial,) = partials(path)
        assert not path.exists()
        assert partial.read_bytes() == b"12" or not live
        file.write(b"34")
    assert path.read_bytes() == b"1234"
    assert names_in(tmp_path) == ["a.bin"]
    with pytest.raises(RecapError, match="is closed"):
        file.write(b"56")


@pytest.mark.parametrize(("number", "appears"), [(EINVAL, True), (ENOSYS, True), (EIO, False)])
def test_a_file_appears_on_a_file_system_that_cannot_sync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, appears: bool
) -> None:
    def refuse(descriptor: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(files, "_SYNC", refuse)
    file = WholeFile(tmp_path / "a")
    file.write(b"abc")
    if appears:
        file.close()
    else:
        with pytest.raises(RecapError, match="cannot be written"):
            file.close()
    assert names_in(tmp_path) == (["a"] if appears else [])


def test_missing_folders_of_a_file_are_made(tmp_path: Path) -> None:
    with WholeFile(tmp_path / "new" / "folder" / "a.bin") as file:
        file.write(b"abc")
    path = tmp_path / "new" / "folder" / "a.bin"
    assert path.read_bytes() == b"abc"
    with pytest.raises(RecapError, match=r"a\.bin: is a file; a folder was expected"):
        WholeFile(path / "b.bin")


def test_folders_that_were_made_for_a_file_go_with_it(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    WholeFile(tmp_path / "old" / "new" / "folder" / "a.bin").abort()
    prepare_file(tmp_path / "other" / "b.bin")
    assert [*tmp_path.rglob("*")] == [tmp_path / "old"]


def test_a_folder_that_goes_with_another_file_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    others = iter(["a", "b"])

    def make(folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        if next(others, None):
            folder.rmdir()  # as another process does that gives up its file

    monkeypatch.setattr(files, "make_folder", make)
    with WholeFile(tmp_path / "new" / "a.bin") as file:
        file.write(b"abc")
    assert names_in(tmp_path / "new") == ["a.bin"]


@pytest.mark.parametrize("has_links", [True, False], ids=["links", "no links"])
def test_a_file_made_meanwhile_is_kept_without_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_links: bool
) -> None:
    link = os.link

    def linked(source: Path, target: Path) -> None:  # another program is a moment earlier
        target.write_bytes(b"mine")
        if not has_links:
            raise OSError(EPERM, os.strerror(EPERM))
        link(source, target)

    monkeypatch.setattr(os, "link", linked)
    with (
        pytest.raises(RecapError, match=r"a\.bin: cannot be written: File exists$"),
        WholeFile(path := tmp_path / "a.bin", force=False),
    ):
        pass
    assert path.read_bytes() == b"mine"
    assert names_in(tmp_path) == ["a.bin"]


def test_a_file_appears_on_a_file_system_without_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "link", lambda *_: (tmp_path / "none").stat())
    with WholeFile(tmp_path / "a.bin", force=False) as file:
        file.write(b"12")
    assert (tmp_path / "a.bin").read_bytes() == b"12"
    assert names_in(tmp_path) == ["a.bin"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.log")
    (tmp_path / "link.mcap").symlink_to("pipe.log")
    for name in ("pipe.log", "link.mcap"):
        with pytest.raises(RecapError, match=f"{name}: cannot be written: is not a regular file"):
            create_recording(tmp_path / name, map_name="Town01")
    assert (tmp_path / "link.mcap").is_fifo()
    assert names_in(tmp_path) == ["link.mcap", "pipe.log"]


def test_a_folder_appears_when_it_is_complete(tmp_path: Path) -> None:
    with new_folder(tmp_path / "new") as folder:
        (folder / "a").write_text("1")
        assert not (tmp_path / "new").exists()
    assert names_in(tmp_path) == ["new"]
    assert names_in(tmp_path / "new") == ["a"]


def test_a_folder_that_exists_keeps_its_other_files(tmp_path: Path) -> None:
    (tmp_path / "old" / "sub").mkdir(parents=True)
    for name in ("a", "b", "sub/c"):
        (tmp_path / "old" / name).write_text("old")
    with new_folder(tmp_path / "old") as folder:
        (folder / "sub").mkdir()
        for name in ("a", "sub/d"):
            (folder / name).write_text("new")
    texts = {name: (tmp_path / "old" / name).read_text() for name in ("a", "b", "sub/c", "sub/d")}
    assert texts == {"a": "new", "b": "old", "sub/c": "old", "sub/d": "new"}


def test_a_new_folder_removes_what_a_killed_process_has_left(tmp_path: Path) -> None:
    script = """
        import os, sys
        from carla_recap.util.files import new_folder
        with new_folder(sys.argv[1]) as folder:
            (folder / "a").touch()
            os.kill(os.getpid(), 9)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "new")], check=False)
    (left,) = partials(tmp_path / "new")
    with new_folder(tmp_path / "new") as running, new_folder(tmp_path / "new") as folder:
        assert sorted(partials(tmp_path / "new")) == sorted([running, folder])
        (folder / "b").touch()
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["b"]
    assert not left.exists()


def test_errors_within_a_new_folder_name_the_destination(tmp_path: Path) -> None:
    destination = tmp_path / "new"
    with pytest.raises(RecapError, match=r"/new: cannot be written: is a directory$"), new_folder(destination) as folder:
        WholeFile(folder)
    assert names_in(tmp_path) == []


def test_a_folder_that_is_not_empty_needs_force(tmp_path: Path) -> None:
    check_folder(tmp_path / "missing", force=False)
    check_folder(tmp_path, force=False)
    (tmp_path / "a").touch()
    check_folder(tmp_path, force=True)
    with pytest.raises(RecapError, match=r"is not empty; --force \(in Python, force=True\)"):
        check_folder(tmp_path, force=False)
    with pytest.raises(RecapError, match="is a file; a folder was expected"):
        check_folder(tmp_path / "a", force=True)


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_an_unused_writer_leaves_nothing(tmp_path: Path, suffix: str) -> None:
    writer = create_writer(tmp_path / f"a{suffix}", Header("Town01", 0))
    assert len(list(tmp_path.iterdir())) == 1
    del writer
    assert list(tmp_path.iterdir()) == []
