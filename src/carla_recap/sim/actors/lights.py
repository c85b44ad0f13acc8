"""Traffic signs and traffic lights as actors, which stand for the signals of the town."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.sim.episode import Actor
from carla_recap.sim.errors import SimError
from carla_recap.sim.signals import RED, UNKNOWN
from carla_recap.sim.validation import LARGEST, expect_between

if TYPE_CHECKING:
    from carla_recap.sim.blueprints import Blueprint
    from carla_recap.sim.episode import Episode
    from carla_recap.sim.signals import Signals
    from carla_recap.sim.town.junctions import Signal

_ACROSS: Final = 90.0
"""Degrees: CARLA turns its lights and signs so much further than the signals of the map, with x across the road."""


class Sign(Actor):
    """A stop, yield or speed-limit sign.

    Attributes:
        signal: The signal of the town that it stands for.
    """

    is_of_town = True

    def __init__(self, episode: Episode, id: int, blueprint: Blueprint, signal: Signal) -> None:
        place = signal.transform.copy()
        place.rotation.yaw = (place.rotation.yaw + _ACROSS + 180) % 360 - 180
        super().__init__(episode, id, blueprint, place)
        self.signal = signal


class _Duration:
    """A duration in s, which is a column of the episode's signals."""

    def __set_name__(self, owner: type[TrafficLight], name: str) -> None:
        self._name = name

    def __get__(self, light: TrafficLight, owner: type[TrafficLight]) -> float:
        return float(getattr(light._signals, self._name)[light.row])

    def __set__(self, light: TrafficLight, seconds: float) -> None:
        light._expect_time(self._name.replace("_", " "), seconds)
        getattr(light._signals, self._name)[light.row] = seconds
        light.episode.pending.light_times.append(light)


class TrafficLight(Sign):
    """A traffic light.

    Attributes:
        row: The row of `World.signals` that has its numbers.
    """

    green_time = _Duration()
    """The duration of green in s."""
    yellow_time = _Duration()
    """The duration of yellow in s."""
    red_time = _Duration()
    """The time after yellow in which all lights of its group are red, in s."""

    def __init__(self, episode: Episode, id: int, blueprint: Blueprint, signal: Signal, row: int) -> None:
        super().__init__(episode, id, blueprint, signal)
        self.row = row

    @property
    def _signals(self) -> Signals:
        self.check()
        return self.episode.signals

    @property
    def state(self) -> int:
        """The state: 0 red, 1 yellow, 2 green, 3 off, 4 unknown. Setting it lasts until the group's next change."""
        return int(self._signals.state[self.row])

    @state.setter
    def state(self, state: int) -> None:
        expect_between("the state of a traffic light", state, RED, UNKNOWN)
        self._signals.set_state(self.row, state)

    def set_state(self, state: int) -> None:
        """Set the state; see `state`."""
        self.state = state

    @property
    def elapsed_time(self) -> float:
        """The time that it has been in its state, in s."""
        return float(self._signals.elapsed[self.row])

    @elapsed_time.setter
    def elapsed_time(self, seconds: float) -> None:
        self._expect_time("time", seconds)
        self._signals.elapsed[self.row] = seconds

    @property
    def frozen(self) -> bool:
        """Whether the time of its group is stopped."""
        return bool(self._signals.frozen[self.row])

    @frozen.setter
    def frozen(self, frozen: bool) -> None:
        self._signals.freeze(self.row, frozen)

    def freeze(self, frozen: bool = True) -> None:
        """Stop the time of its group, or continue it."""
        self.frozen = frozen

    @property
    def group(self) -> list[TrafficLight]:
        """The traffic lights of its junction, itself included."""
        rows = self._signals.group_of(self.row)
        return [light for light in traffic_lights(self.episode) if light.row in rows]

    def reset_group(self) -> None:
        """Restart the cycle of its group."""
        self._signals.reset(self.row)

    @property
    def affected_lanes(self) -> tuple[tuple[int, float], ...]:
        """The lanes that it governs, and the distance of the stop line along each, in m."""
        return self.signal.stops

    def _expect_time(self, what: str, seconds: float) -> None:
        if not 0 <= seconds <= LARGEST:
            raise SimError(f"{self!r}: a {what} of {seconds:g} s: expected 0 s or more, and at most {LARGEST:g} s")


def traffic_lights(episode: Episode) -> list[TrafficLight]:
    """Return all traffic lights; light i is row i of the episode's `signals`."""
    return [actor for actor in episode.actors.values() if isinstance(actor, TrafficLight)]
