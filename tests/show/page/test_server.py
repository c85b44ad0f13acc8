"""The server gives out the page's files, to this machine, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path
from threading import Thread

import pytest

from carla_recap import RecapError
from carla_recap.show.page import page_server
from tests.waiting import PATIENCE


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    page = tmp_path / "page"
    (page / "data").mkdir(parents=True)
    (page / "index.html").write_text("<h1>page</h1>")
    (page / "page.js").write_text("1")
    (tmp_path / "secret.txt").write_text("secret")
    (page / "link.txt").symlink_to(tmp_path / "secret.txt")
    return page


@contextmanager
def serving(folder: Path) -> Iterator[int]:
    with page_server(folder) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


def get(port: int, path: str, **headers: str) -> tuple[int, str | None, bytes]:
    connection = HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    found = answer.status, answer.getheader("Content-Type"), answer.read()
    connection.close()
    return found


def test_it_serves_files_with_their_types(folder: Path) -> None:
    with serving(folder) as port:
        assert get(port, "/") == (200, "text/html", b"<h1>page</h1>")
        assert get(port, "/page.js")[:2] == (200, "text/javascript")


def test_it_serves_nothing_else(folder: Path) -> None:
    with serving(folder) as port:
        for path in ("/data/", "/../secret.txt", "/%2e%2e/secret.txt", "/link.txt", "//etc/passwd", "/nothing", "/%00"):
            assert get(port, path)[0] == 404, path
        assert get(port, "/", Host="elsewhere.example")[0] == 403


def test_invalid_arguments_are_errors(folder: Path) -> None:
    with pytest.raises(RecapError, match=r"has no index\.html"):
        page_server(folder / "data")
    with page_server(folder) as server, pytest.raises(RecapError, match="cannot be served"):
        page_server(folder, server.server_port)
