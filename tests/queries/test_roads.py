"""What queries answer that take the roads of a map which is unknown."""

from __future__ import annotations

from contextlib import closing

import pytest

from carla_recap import RecapError, RecapWarning
from carla_recap.formats import open_reader
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.measures import measures_on_roads
from carla_recap.queries.roads import roads_of
from tests.samples import CROSSING

WARNING = "'Crossing' is unknown; rules of the road are left out; --map or CARLA_RECAP_MAPS says where maps are"


@pytest.fixture
def crossing(monkeypatch):
    """A recording of an unknown map."""
    monkeypatch.delenv("CARLA_RECAP_MAPS", raising=False)
    with closing(open_reader(CROSSING)) as reader:
        yield reader


@pytest.mark.parametrize("kinds", ["all", ["collision", "red light"]])
def test_kinds_of_the_road_are_left_out_with_a_warning(crossing, kinds):
    with pytest.warns(RecapWarning, match=WARNING) as caught:
        found = incidents(crossing, IncidentOptions(kinds=kinds))
    assert len(caught) == 1
    assert "collision" in {row.kind for row in found}


def test_kinds_of_the_road_alone_are_an_error(crossing):
    with pytest.raises(RecapError, match="is unknown, but its roads are needed; --map or CARLA_RECAP_MAPS"):
        incidents(crossing, IncidentOptions(kinds=["red light", "speeding"]))


def test_measures_of_the_road_are_left_out_with_a_warning(crossing):
    with pytest.warns(RecapWarning, match=WARNING) as caught:
        assert measures_on_roads(crossing)
    assert len(caught) == 1


@pytest.mark.parametrize("folder", [True, False])
def test_a_given_folder_without_the_map_is_an_error(crossing, tmp_path, folder):
    with pytest.raises(RecapError, match=r"no \.xodr in" if folder else "is unknown, but its roads are needed"):
        roads_of(crossing, str(tmp_path) if folder else None, needed=not folder)
