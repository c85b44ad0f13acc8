"""The table of infractions, and what they cost by each formula."""

from __future__ import annotations

import pytest

from carla_recap.queries.score import INFRACTIONS, Infraction
from carla_recap.queries.score.infractions import penalty_of


def infraction(kind: str, share: float = 1.0) -> Infraction:
    return Infraction(kind, 1.0, 0.0, 0.0, 0.0, None, "", share, "")


def test_in_the_first_versions_factors_are_multiplied() -> None:
    found = [infraction("collisions_pedestrian"), infraction("red_light"), infraction("red_light")]
    assert penalty_of(found, "2.0") == pytest.approx(0.5 * 0.7 * 0.7)
    assert penalty_of(found, "1.0") == pytest.approx(0.5 * 0.7 * 0.7)
    assert penalty_of([], "2.0") == 1.0


def test_in_2_1_coefficients_are_added() -> None:
    found = [infraction("collisions_pedestrian"), infraction("red_light"), infraction("stop_infraction")]
    assert penalty_of(found, "2.1") == pytest.approx(1 / (1 + 1.0 + 0.4 + 0.25))


def test_a_share_of_the_route_or_of_the_speed_counts() -> None:
    assert penalty_of([infraction("outside_route_lanes", 0.2)], "1.0") == pytest.approx(0.8)
    assert penalty_of([infraction("min_speed_infractions", 0.5)], "2.0") == pytest.approx(1 - 0.3 * 0.5)
    both = [infraction("outside_route_lanes", 0.2), infraction("min_speed_infractions", 0.5)]
    assert penalty_of(both, "2.1") == pytest.approx(0.8 / (1 + 0.4 * 0.5))


def test_1_0_knows_neither_slow_drives_nor_emergency_vehicles() -> None:
    found = [infraction("min_speed_infractions", 0.5), infraction("yield_emergency_vehicle_infractions")]
    assert penalty_of(found, "1.0") == 1.0
    assert not any(INFRACTIONS[each.kind].counts("1.0") for each in found)


def test_what_ends_a_route_costs_no_points() -> None:
    ends = [infraction(name) for name, kind in INFRACTIONS.items() if kind.ends]
    assert len(ends) == 3
    assert [penalty_of(ends, formula) for formula in ("1.0", "2.0", "2.1")] == [1.0, 1.0, 1.0]
