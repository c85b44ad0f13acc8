"""Texts of recordings that are not valid UTF-8."""

from __future__ import annotations

import pytest

from carla_recap.util.text import first_of, readable, single_line


@pytest.mark.parametrize(
    ("raw", "shown"),
    [
        (b"plain", "plain"),
        ("été 🚗".encode(), "été 🚗"),
        (b"cut\0off", "cut"),
        (b"\xe9t\xe9.", "?t?."),
        (b"\xed\xa0\x80.", "???."),  # a surrogate
        (b"\xc0\xaf.", "??."),  # longer than need be
        (b"\xf8\x88\x80\x80\x80.", "?."),  # once, five bytes were allowed
        (b"\xef\xbf\xbe.", "???."),  # no character
        (b"\xf4\x90\x80\x80.", "????."),  # beyond the last one
        (b"\xff\xfe", "?"),  # cut off by the end
        (b"\xf0\x9f\x9a", "???"),
        (b"\xc3\xa9\xe9", "é?"),
    ],
)
def test_readable(raw: bytes, shown: str) -> None:
    assert readable(raw.decode("utf-8", "surrogateescape")) == shown


@pytest.mark.parametrize(
    ("names", "text"), [([], "none"), (["a", "b", "c"], "a, b, c"), (["a", "b", "c", "d", "e"], "a, b, c, and 2 more")]
)
def test_the_first_of_many_names(names: list[str], text: str) -> None:
    assert first_of(names) == text


def test_a_text_of_several_lines_becomes_a_single_one() -> None:
    assert single_line(ValueError(" one\n\ttwo  three\n")) == "one two three"
