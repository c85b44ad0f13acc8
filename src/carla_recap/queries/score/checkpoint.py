"""Scores as the results of CARLA's Leaderboard, which its tools read, and what they show of the abilities of Bench2Drive."""

from __future__ import annotations

import math
from statistics import fmean, stdev
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from carla_recap.queries.score.infractions import INFRACTIONS
from carla_recap.queries.score.scoring import COMPLETED, FAILED, PERFECT

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from carla_recap.queries.score.scoring import Score

_DIGITS: Final = 3
_SCORE_DIGITS: Final = 6
_LEAST: Final = 0.001  # km by which numbers of infractions are divided at least
_BY_LENGTH: Final = "outside_route_lanes"
"""The infraction that is summed by its length in km, and not counted."""
_SCORES: Final = {"score_composed": "score", "score_route": "completion", "score_penalty": "penalty"}
_LABELS: Final = {
    "score_composed": "Avg. driving score",
    "score_route": "Avg. route completion",
    "score_penalty": "Avg. infraction penalty",
}

ABILITIES: Final[Mapping[str, frozenset[str]]] = {
    name: frozenset(types.split())
    for name, types in {
        "Overtaking": "Accident AccidentTwoWays ConstructionObstacle ConstructionObstacleTwoWays HazardAtSideLane "
        "HazardAtSideLaneTwoWays ParkedObstacle ParkedObstacleTwoWays VehicleOpensDoorTwoWays",
        "Merging": "CrossingBicycleFlow EnterActorFlow HighwayCutIn HighwayExit InterurbanActorFlow "
        "InterurbanAdvancedActorFlow MergerIntoSlowTraffic MergerIntoSlowTrafficV2 "
        "NonSignalizedJunctionLeftTurn NonSignalizedJunctionLeftTurnEnterFlow NonSignalizedJunctionRightTurn "
        "ParkingExit SequentialLaneChange SignalizedJunctionLeftTurn SignalizedJunctionLeftTurnEnterFlow "
        "SignalizedJunctionRightTurn",
        "Emergency_Brake": "BlockedIntersection ControlLoss DynamicObjectCrossing HardBreakRoute "
        "OppositeVehicleRunningRedLight OppositeVehicleTakingPriority ParkingCrossingPedestrian ParkingCutIn "
        "PedestrianCrossing StaticCutIn VehicleTurningRoute VehicleTurningRoutePedestrian",
        "Give_Way": "InvadingTurn YieldToEmergencyVehicle",
        "Traffic_Signs": "BlockedIntersection CrossingBicycleFlow EnterActorFlow NonSignalizedJunctionLeftTurn "
        "NonSignalizedJunctionLeftTurnEnterFlow NonSignalizedJunctionRightTurn OppositeVehicleRunningRedLight "
        "OppositeVehicleTakingPriority PedestrianCrossing SignalizedJunctionLeftTurn SignalizedJunctionLeftTurnEnterFlow "
        "SignalizedJunctionRightTurn T_Junction VanillaNonSignalizedTurn VanillaNonSignalizedTurnEncounterStopsign "
        "VanillaSignalizedTurnEncounterGreenLight VanillaSignalizedTurnEncounterRedLight VehicleTurningRoute "
        "VehicleTurningRoutePedestrian",
    }.items()
}
"""The types of scenarios that ask for each ability, by its name in Bench2Drive."""

_SIGNS: Final = "Traffic_Signs"  # the ability for which a route may count that is no success
_SIGN_INFRACTIONS: Final = ("stop_infraction", "red_light")


def checkpoint(scores: Sequence[Score]) -> dict[str, Any]:
    """Return scores in the form of the Leaderboard's results, with additional fields.

    They are the recording, the events, and the numbers of Bench2Drive. The computing time of a drive is unknown, and 0.
    """
    records = [_record(index, score) for index, score in enumerate(scores)]
    overall = _global_record(scores, records)
    mean, infractions = overall["scores_mean"], overall["infractions"]
    return {
        "_checkpoint": {
            "global_record": overall,
            "progress": [len(scores), len(scores)],
            "records": records,
            "bench2drive": bench2drive(scores),
        },
        "entry_status": "Finished",
        "eligible": True,
        "sensors": [],
        "values": [str(mean[name]) for name in _LABELS] + [str(infractions[name]) for name in INFRACTIONS],
        "labels": [*_LABELS.values(), *(kind.label for kind in INFRACTIONS.values())],
    }


def means(scores: Sequence[Score]) -> dict[str, tuple[float, float]]:
    """Return the mean and the standard deviation of the score, the completion and the penalty, by their names."""
    found = {}
    for name in _SCORES.values():
        values = [getattr(score, name) for score in scores]
        found[name] = (fmean(values), stdev(values) if len(values) > 1 else 0.0) if values else (0.0, 0.0)
    return found


def bench2drive(scores: Sequence[Score]) -> dict[str, Any]:
    """Return the numbers of Bench2Drive of all scores; None where no score has them."""
    shown = [each for each in abilities(scores) if each.routes]
    shares = {each.name: 100 * each.passed / each.routes for each in shown}
    return {
        "success_rate": _mean(None if each.success is None else 100.0 * each.success for each in scores),
        "driving_efficiency": _mean(each.efficiency for each in scores),
        "driving_smoothness": _mean(each.smoothness for each in scores),
        "abilities": {**{name: round(share, _DIGITS) for name, share in shares.items()}, "mean": _mean(shares.values())},
    }


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(fmean(known), _DIGITS) if known else None


def _record(index: int, score: Score) -> dict[str, Any]:
    by_kind = {name: [each.text for each in score.infractions if each.kind == name] for name in INFRACTIONS}
    return {
        "index": index,
        "route_id": f"RouteScenario_{score.route or index}_rep{score.repetition}",
        "status": score.status,
        "num_infractions": len(score.infractions),
        "infractions": by_kind,
        "scores": {name: round(getattr(score, field), _SCORE_DIGITS) for name, field in _SCORES.items()},
        "meta": {
            "route_length": round(score.route_length, _DIGITS),
            "duration_game": round(score.duration, _DIGITS),
            "duration_system": 0,
        },
        "recording": score.recording,
        "formula": score.formula,
        "driven": round(score.driven, _DIGITS),
        "scenario": score.scenarios[0] if score.scenarios else None,
        "success": score.success,
        "driving_efficiency": _mean([score.efficiency]),
        "driving_smoothness": _mean([score.smoothness]),
        "comfort": {name: round(share, _DIGITS) for name, share in score.within.items()},
        "events": [
            {
                "kind": each.kind,
                "time": round(each.time, _DIGITS),
                **{axis: round(getattr(each, axis), _DIGITS) for axis in "xyz"},
                "actor": each.actor,
                "type_id": each.type_id,
                "share": round(each.share, _SCORE_DIGITS),
                "link": each.link,
            }
            for each in score.infractions
        ],
    }


def _global_record(scores: Sequence[Score], records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    averages = means(scores)
    failed = [
        [record["route_id"], record["index"], record["status"]] for record in records if record["status"].startswith(FAILED)
    ]
    driven = sum(score.route_length / 1000 * score.completion / 100 for score in scores)
    total = {name: float(sum(score.count(name) for score in scores)) for name in INFRACTIONS}
    outside = [
        each.share * score.route_length * score.completion / 100
        for score in scores
        for each in score.infractions
        if each.kind == _BY_LENGTH
    ]
    per_km = {name: count / max(driven, _LEAST) for name, count in total.items()} | {_BY_LENGTH: math.fsum(outside) / 1000}
    is_perfect = all(score.status == PERFECT for score in scores)
    return {
        "index": -1,
        "route_id": -1,
        "status": FAILED if failed else PERFECT if is_perfect else COMPLETED,
        "infractions": {name: round(value, _DIGITS) for name, value in per_km.items()},
        "scores_mean": {name: round(averages[field][0], _SCORE_DIGITS) for name, field in _SCORES.items()},
        "scores_std_dev": {name: round(averages[field][1], _DIGITS) for name, field in _SCORES.items()},
        "meta": {
            "total_length": round(sum(score.route_length for score in scores), _DIGITS),
            "duration_game": round(sum(score.duration for score in scores), _DIGITS),
            "duration_system": 0,
            "exceptions": failed,
        },
    }


class Ability(NamedTuple):
    """What routes with scenarios of an ability show."""

    name: str  # of the ability, a key of `ABILITIES`
    passed: int  # the number of routes that are a success
    routes: int


def abilities(scores: Iterable[Score]) -> list[Ability]:
    """Return what the routes of scores show of each ability; the first scenario of a route says for which it counts.

    For `Traffic_Signs`, a route also counts as a success if the hero passes its first junction without an infraction of a
    light or a stop sign.
    """
    found = {name: Ability(name, 0, 0) for name in ABILITIES}
    for score in scores:
        for name, types in ABILITIES.items():
            if score.scenarios and score.scenarios[0] in types:
                _, passed, routes = found[name]
                has_passed = bool(score.success) or (name == _SIGNS and _keeps_signs(score))
                found[name] = Ability(name, passed + has_passed, routes + 1)
    return list(found.values())


def _keeps_signs(score: Score) -> bool:
    is_beyond = score.junction is not None and score.completion > score.junction
    return is_beyond and not any(score.count(kind) for kind in _SIGN_INFRACTIONS)
