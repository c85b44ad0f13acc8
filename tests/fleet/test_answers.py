"""Answers to one query of many recordings."""

from __future__ import annotations

import warnings
from typing import Any

import pytest

from carla_recap.errors import RecapWarning
from carla_recap.fleet.answers import answers
from carla_recap.fleet.sources import find_sources
from carla_recap.formats.base import Reader
from carla_recap.queries.info import info
from tests.samples import SAMPLES


def warned(reader: Reader) -> Any:
    warnings.warn("an odd frame", RecapWarning, stacklevel=1)
    return info(reader, all=True)


@pytest.mark.parametrize("most", [0, 1 << 20])
def test_answers_have_their_warnings_however_long_they_are(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr("carla_recap.fleet.answers._MOST", most)
    (found,) = answers(warned, "json", find_sources([SAMPLES / "crossing.log"]), jobs=1)
    assert len(list(found.pieces)) == found.rows > 0
    assert found.warnings == ("an odd frame",)
