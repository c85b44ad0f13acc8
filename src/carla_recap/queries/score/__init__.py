"""Scores of recordings, as CARLA's Leaderboard scores drives along routes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.queries.score.infractions import FORMULAS, INFRACTIONS, Formula, Infraction, InfractionKind
    from carla_recap.queries.score.route_files import Route, read_routes, route_for
    from carla_recap.queries.score.scoring import Score, ScoreOptions, score

__all__ = [
    "FORMULAS",
    "INFRACTIONS",
    "Formula",
    "Infraction",
    "InfractionKind",
    "Route",
    "Score",
    "ScoreOptions",
    "read_routes",
    "route_for",
    "score",
]

__getattr__, __dir__ = lazily(
    __name__,
    {
        "infractions": ("FORMULAS", "INFRACTIONS", "Formula", "Infraction", "InfractionKind"),
        "route_files": ("Route", "read_routes", "route_for"),
        "scoring": ("Score", "ScoreOptions", "score"),
    },
)
