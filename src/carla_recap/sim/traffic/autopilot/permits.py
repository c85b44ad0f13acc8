"""Who may pass which gate: one after the other where ways cross, by lights, signs, priority, and who came first."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.sim.traffic.autopilot.network import NONE

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.sim.traffic.autopilot.gates import Crossings, Gate

    Room = Callable[[Gate], float]

PATIENCE: Final = 4.0  # s: who waits longer lets nobody in before
LONG: Final = 20.0  # s: who waits longer goes when the way is free, even if others who are stuck hold a permit
_STUCK: Final = 10.0  # s: who stands longer in a junction
_AT_LINE: Final = 12.0  # m: who is nearer to the line waits there
_GAP: Final = 2.0  # m: between vehicles that stand


@dataclass
class Request:
    """A vehicle that wants to pass its gate.

    Attributes:
        id: The vehicle.
        gate: The gate.
        since: When it came to it, in s.
        distance: From its front end to the line, in m.
        length: Of the vehicle, in m.
        free: How far its way is free from its front end on, in m.
    """

    id: int
    gate: Gate
    since: float
    distance: float
    length: float
    free: float


class Permits:
    """The permits that are given, by lane.

    Args:
        crossings: What gates are made of.
        place: How far the rear end of a vehicle has come along its route, in m.
        stood: For how long it has stood, in s.
    """

    def __init__(self, crossings: Crossings, place: Callable[[int], float], stood: Callable[[int], float]) -> None:
        self._conflicts = crossings.conflicts
        self._place, self._stood = place, stood
        self._holders: dict[int, dict[int, float]] = defaultdict(dict)  # lane → vehicle → where the lane begins
        self._coming: dict[int, dict[int, tuple[float, float]]] = defaultdict(dict)  # exit → vehicle → begin, room

    def hold(self, id: int, gate: Gate, length: float) -> None:
        """Give a permit."""
        for lane, start in gate.lanes:
            self._holders[lane][id] = start
        if gate.exits:
            self._coming[gate.exits[0][0]][id] = gate.leave, length + _GAP

    def release(self, id: int, gate: Gate) -> None:
        """Take a permit back."""
        for lane, _ in gate.lanes:
            self._holders[lane].pop(id, None)
        if gate.exits:
            self._coming[gate.exits[0][0]].pop(id, None)

    def grant(self, requests: list[Request], now: float, room: Room) -> list[Request]:
        """Decide who may go.

        Args:
            requests: The requests of all who wait.
            now: In s.
            room: How much room there is behind a junction, on the lanes of a route from there on, in m.

        Returns:
            The requests that are granted; their permits are given.
        """
        granted: list[Request] = []
        claimed: set[int] = set()
        reserved: set[int] = set()
        asked: dict[int, list[Request]] = defaultdict(list)
        for request in requests:
            for lane, _ in request.gate.lanes:
                asked[lane].append(request)
        for request in sorted(requests, key=lambda request: (request.since, request.id)):
            lanes = [lane for lane, _ in request.gate.lanes]
            waited = now - request.since
            exit = request.gate.exits[0][0] if request.gate.exits else NONE
            if exit in reserved or self._is_full(request, room):
                if waited > PATIENCE and exit != NONE:
                    reserved.add(exit)
                continue
            if not (
                any(lane in claimed or self._is_taken(request, lane, waited) for lane in lanes)
                or (waited < PATIENCE and self._has_to_yield(request, asked))
            ):
                self.hold(request.id, request.gate, request.length)
                granted.append(request)
            elif waited > PATIENCE and request.distance < _AT_LINE:
                claimed.update(conflict.other for lane in lanes for conflict, _ in self._conflicts[lane])
        return granted

    def _is_taken(self, request: Request, lane: int, waited: float) -> bool:
        """Whether another vehicle holds a lane that conflicts with a lane, and has not yet cleared the conflict.

        Whoever has waited for long, and sees the way free, minds no more those who stand there.
        """
        bold = waited > LONG and request.free > request.distance + request.gate.leave - request.gate.line
        return any(
            other != request.id and self._place(other) < start + end and not (bold and self._is_stuck(other, start))
            for conflict, end in self._conflicts[lane]
            for other, start in self._holders[conflict.other].items()
        )

    def _is_stuck(self, id: int, begin: float) -> bool:
        """Whether a vehicle has stood for long on a lane that begins somewhere along its route."""
        return self._stood(id) > _STUCK and self._place(id) > begin

    def _has_to_yield(self, request: Request, asked: dict[int, list[Request]]) -> bool:
        """Whether a vehicle with priority is coming."""
        return any(
            conflict.yields and any(other is not request for other in asked.get(conflict.other, ()))
            for lane, _ in request.gate.lanes
            for conflict, _ in self._conflicts[lane]
        )

    def _is_full(self, request: Request, room: Room) -> bool:
        """Whether a vehicle could not leave the junction again."""
        gate = request.gate
        if not gate.lanes or not gate.exits:
            return False
        coming = self._coming[gate.exits[0][0]]
        needed = sum(need for id, (leave, need) in coming.items() if id != request.id and self._place(id) < leave)
        return room(gate) < needed + request.length + _GAP
