from __future__ import annotations

import pytest

from carla_recap.errors import RecapError
from carla_recap.util.functions import function_in

SOURCE = """
from functools import partial
from helpers_of_runs import helper

def run(world, delay, speed=3, *, town="a", **more): return (helper(), world, delay, speed, town, more)
def plain(world): ...
made = partial(run, delay=4)
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "helpers_of_runs.py").write_text("def helper(): return 'helps'\n")
    (tmp_path / "file.py").write_text(SOURCE)
    return tmp_path / "file.py"


def test_a_function_of_a_file_is_called(file):
    function, keywords = function_in(f"{file}:run")
    assert (keywords.names, keywords.required, keywords.has_any) == (("delay", "speed", "town"), {"delay"}, True)
    assert function("w", delay=1, extra=2) == ("helps", "w", 1, 3, "a", {"extra": 2})


def test_what_is_no_plain_function_is_called_too(file):
    function, keywords = function_in(f"{file}:made")
    assert keywords is None
    assert function("w")[2] == 4


@pytest.mark.parametrize(
    ("content", "name", "message"),
    [
        (SOURCE, "gone", "has no function gone; it has run, plain"),
        ("def run(:\n", "run", ":1: "),
        ("x = '\0'", "run", "expected Python"),
        (b"\xff\xfe", "run", "expected Python|:1: "),
        ("(" * 5000, "run", "expected Python|:1: "),
        ("", "run", "has no function run"),
    ],
)
def test_a_file_without_the_function_is_an_error(tmp_path, content, name, message):
    path = tmp_path / "file.py"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RecapError, match=message) as caught:
        function_in(f"{path}:{name}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "place", ["file.py", "gone.py:run", ":run", "file.py:", "file.py:1", "x" * 10_000, "/:run", "a\0b:run"]
)
def test_a_place_that_is_none_is_an_error(place):
    with pytest.raises(RecapError) as caught:
        function_in(place)
    assert len(str(caught.value)) < 400


def test_a_file_is_not_run_before_the_call(tmp_path):
    (tmp_path / "file.py").write_text("raise LookupError\ndef run(world): ...\n")
    function, _ = function_in(f"{tmp_path / 'file.py'}:run")
    with pytest.raises(LookupError):
        function()
