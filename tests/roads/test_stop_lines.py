"""The limits of the stop lines of a map, which say what they leave out."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.errors import RecapWarning
from carla_recap.roads import stop_lines
from carla_recap.roads.opendrive import read_opendrive
from tests.roads import towns


def test_painted_lines_beyond_the_limit_warn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_lines, "_MOST_LINES", 1)
    painted = towns.painted_stop(50, -1.75, 3.5)
    content = read_opendrive(towns.opendrive(towns.road(1, inside=painted), towns.road(2, y=50, inside=painted)))
    with pytest.warns(RecapWarning, match="of 2 painted stop lines, 1 are drawn"):
        found, _ = stop_lines.drawn_stop_lines(content.roads)
    assert np.shape(found) == (1, 2, 3)


def test_signals_beyond_the_limit_warn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_lines, "_MOST_LINES", 1)
    sign = towns.stop_sign(50, -1, -1)
    signs = sign, sign.replace('id="7"', 'id="8"')
    content = read_opendrive(towns.opendrive(*(towns.road(id, y=50 * id, inside=each) for id, each in enumerate(signs))))
    with pytest.warns(RecapWarning, match="signals from 8 on are left out: those before have 1 stop lines"):
        signals, lines, ids = stop_lines.signal_tables(content.roads)
    assert (len(signals), len(lines), ids) == (1, 1, ("7",))


def test_places_of_a_signal_beyond_the_limit_warn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_lines, "_MOST_PLACES", 1)
    sign = towns.stop_sign(50, -1, -1)
    content = read_opendrive(towns.opendrive(*(towns.road(id, y=50 * id, inside=sign) for id in (1, 2))))
    with pytest.warns(RecapWarning, match="of 2 places of signal 7, 1 are looked at"):
        stop_lines.signal_tables(content.roads)
