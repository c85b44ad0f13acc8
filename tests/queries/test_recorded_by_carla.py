"""A recording that CARLA has made, which is a sample: it is read, converted and printed as CARLA does."""

from __future__ import annotations

from pathlib import Path

import pytest

from carla_recap import convert, open_recording
from carla_recap.formats import open_reader
from carla_recap.output.text import text
from carla_recap.queries.info import info

LOG = Path(__file__).parents[2] / "samples" / "town01-carla-0.9.13.log"


@pytest.fixture(scope="module")
def mcap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("converted") / "a.mcap"
    convert(LOG, path)
    return path


def test_it_is_the_same_after_a_conversion_to_mcap_and_back(mcap: Path) -> None:
    convert(mcap, mcap.with_suffix(".log"))
    assert mcap.with_suffix(".log").read_bytes() == LOG.read_bytes()


def test_its_contents_are_printed_as_carla_does(mcap: Path) -> None:
    expected = LOG.with_suffix(".txt").read_text("utf-8")
    for path in (LOG, mcap):
        reader = open_reader(path)
        assert "".join(text(info(reader, compat=True))) == expected
        reader.close()


def test_it_holds_what_carla_records() -> None:
    with open_recording(LOG) as recording:
        assert (recording.header.map_name, recording.info.frames) == ("Town01", 60)
        (hero,) = recording.heroes
        assert (hero.id, hero.type_id) == (234, "vehicle.lincoln.mkz_2017")
        assert hero.bounding_box.extent_x == pytest.approx(2.45, abs=0.01)
