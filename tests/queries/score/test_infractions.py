"""The table of infractions, and what they cost by each formula."""

from __future__ import annotations

import pytest

from carla_recap.queries.score import INFRACTIONS, Infraction
from carla_recap.queries.score.infractions import penalty_of

BOTH = (("outside_route_lanes", 0.2), ("min_speed_infractions", 0.5))
LATER = (("min_speed_infractions", 0.5), ("yield_emergency_vehicle_infractions", 1.0))
ENDS = tuple((name, 1.0) for name, kind in INFRACTIONS.items() if kind.ends)


@pytest.mark.parametrize(
    ("infractions", "formula", "penalty"),
    [
        ((), "2.0", 1.0),
        ((("collisions_pedestrian", 1.0), ("red_light", 1.0), ("red_light", 1.0)), "1.0", 0.5 * 0.7 * 0.7),
        ((("collisions_pedestrian", 1.0), ("red_light", 1.0), ("red_light", 1.0)), "2.0", 0.5 * 0.7 * 0.7),
        ((("collisions_pedestrian", 1.0), ("red_light", 1.0), ("stop_infraction", 1.0)), "2.1", 1 / (1 + 1.0 + 0.4 + 0.25)),
        (BOTH[:1], "1.0", 0.8),
        (BOTH[1:], "2.0", 1 - 0.3 * 0.5),
        (BOTH, "2.1", 0.8 / (1 + 0.4 * 0.5)),
        (LATER, "1.0", 1.0),  # which knows neither slow drives nor emergency vehicles
        *((ENDS, formula, 1.0) for formula in ("1.0", "2.0", "2.1")),
    ],
)
def test_penalties(infractions: tuple[tuple[str, float], ...], formula: str, penalty: float) -> None:
    found = [Infraction(kind, 1.0, 0.0, 0.0, 0.0, None, "", share, "") for kind, share in infractions]
    assert penalty_of(found, formula) == pytest.approx(penalty)
