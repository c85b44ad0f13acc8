"""`tools/check-site`, which `make docs` runs on the pages of the site."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.samples import ROOT

TOOL = ROOT / "tools" / "check-site"


def check(folder, page):
    """Return the exit code and the faults of a site with a page beside another one."""
    (folder / "index.html").write_text(page, "utf-8")
    (folder / "other.html").write_text('<h2 id="here">Here</h2>', "utf-8")
    done = subprocess.run([sys.executable, TOOL, folder], capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, done.stderr.splitlines()


def test_links_that_resolve(tmp_path):
    page = '<h1 id="top">Top</h1><a href="#top"><a href="other.html#here"><a href="https://carla.org"><img src="data:,">'
    assert check(tmp_path, page) == (0, [])


@pytest.mark.parametrize(
    ("page", "fault"),
    [
        ('<a href="none.html">', "no file none.html"),
        ('<a href="other.html#there">', "no anchor other.html#there"),
        ('<a href="/other.html">', "no file /other.html"),
        ('<img src="none.png">', "no file none.png"),
        ('<script src="https://unpkg.com/x.js"></script>', "loads https://unpkg.com/x.js"),
    ],
)
def test_a_link_that_does_not_resolve(tmp_path, page, fault):
    assert check(tmp_path, page) == (1, [f"index.html: {fault}"])
