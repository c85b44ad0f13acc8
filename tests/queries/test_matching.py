"""Which actors of two recordings are the same, where their ids differ."""

from __future__ import annotations

import pytest

from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn
from carla_recap.queries.matching import match


def life(id: int, spawned_at: float = 0.0, x: float = 0.0) -> ActorLife:
    return ActorLife(id, "walker.pedestrian.0001", "walker", "", spawned_at, spawn=Spawn(id, 2, 100 * x))


def pairs(ours: list[ActorLife], theirs: list[ActorLife]) -> list[tuple[int, int]]:
    return sorted((ours[found.a].id, theirs[found.b].id) for found in match(ours, theirs))


@pytest.mark.parametrize("order", [1, -1])
def test_of_those_at_one_place_the_one_of_the_same_time_is_matched(order: int) -> None:
    others = [life(20, 0.0), life(21, 1.0), life(22, 3.0)][::order]
    assert pairs([life(10, 1.0)], others) == [(10, 21)]
    assert pairs([life(10, 2.9)], others) == [(10, 22)]


@pytest.mark.parametrize("order", [1, -1])
def test_the_nearest_is_matched(order: int) -> None:
    others = [life(20, x=0.4), life(21, x=-0.2), life(22, x=0.3)][::order]
    assert pairs([life(10)], others) == [(10, 21)]
    assert pairs([life(10), life(11, x=0.31)], others) == [(10, 21), (11, 22)]
