"""What scores show of the abilities of Bench2Drive, as its `tools/ability_benchmark.py` counts them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from carla_recap.queries.score.scoring import Score

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
