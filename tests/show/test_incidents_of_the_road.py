"""Tests that exports show incidents, and where the map is known what vehicles do against the rules of the road."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap import create_recording, open_recording
from carla_recap.model.records import Spawn
from carla_recap.queries.incidents import IncidentOptions
from carla_recap.replay import Player
from carla_recap.roads import RoadMap
from carla_recap.roads.surfaces import road_network_of_map
from carla_recap.scene.captions import PlayedIncidents, incident_lines, shown_options
from carla_recap.show.video.film import Film
from tests.roads.straight_road import LIGHT_POSITION, STRAIGHT_ROAD

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from carla_recap.recording import Recording

TICK = 0.05
RUN = "vehicle.mini.cooper_s (7) runs a red light at 36 km/h (light 3)"


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[Recording]:
    """A car that runs a red light after 5 s."""
    x, y = LIGHT_POSITION
    spawned = [Spawn(3, 3, 100 * x, -100 * y, type_id="traffic.traffic_light"), Spawn(7, 1, type_id="vehicle.mini.cooper_s")]
    path = tmp_path / "run.mcap"
    with create_recording(path, map_name="Straight", date=0) as recorder:
        for index in range(160):
            frame = {
                "transforms": [(7, 5000.0 + 1000 * index * TICK, 175.0, 0.0, 0.0, 0.0, 0.0)],
                "light_states": [(3, False, 0.0, 0)],
            }
            recorder.add_frame(index * TICK, **({"spawned": spawned} if index == 0 else {}), **frame)
    with open_recording(path) as opened:
        yield opened


def road_map(opendrive: str = STRAIGHT_ROAD) -> RoadMap:
    return RoadMap("Straight", [], [], [], [], [], opendrive=opendrive)


@pytest.mark.parametrize(("start", "lines"), [(0.0, [RUN]), (4.0, [RUN]), (6.0, [])])
def test_the_log_of_exports_has_those_that_are_played(recording: Recording, start: float, lines: list[str]) -> None:
    player = Player(recording, start=start)
    played = PlayedIncidents(player, road_network_of_map(road_map()))
    elapsed = np.concatenate([batch.time for batch in player.batches()])
    assert [line.text for _, line in incident_lines(played.found(), elapsed)] == lines


@pytest.mark.parametrize(
    ("options", "captions"),
    [
        (None, {"Mini Cooper S (7) runs a red light at 36 km/h (light 3)"}),
        (IncidentOptions(kinds=["red light"]), {"Mini Cooper S (7) runs a red light at 36 km/h (light 3)"}),
        (IncidentOptions(kinds=["collision"]), set()),
    ],
)
def test_captions_and_marks_of_a_video_have_them(
    recording: Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: IncidentOptions | None,
    captions: set[str],
) -> None:
    (tmp_path / "Straight.xodr").write_text(STRAIGHT_ROAD)
    monkeypatch.setenv("CARLA_RECAP_MAPS", str(tmp_path))
    shown = shown_options(recording.reader, options)
    film = Film(recording, Player(recording, start=4.0), "top", (640, 360), rate=4.0, shown=shown)
    assert {caption.text for shot in film.shots() for caption in shot.readings.captions} == captions


@pytest.mark.parametrize("opendrive", ["", "no XML", "<OpenDRIVE/>"])
def test_maps_without_lanes_have_no_network(opendrive: str) -> None:
    assert road_network_of_map(road_map(opendrive)) is None
    assert road_network_of_map(None) is None
