"""Which lamps are lit: the only place that decides it, for every viewer, for cameras, and for what the autopilot records."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.motion import MAX_DECELERATION, motion_of
from carla_recap.replay.events import Spawned
from carla_recap.replay.motion import recorded_motion
from carla_recap.replay.selection import NO_IDS, find
from carla_recap.scene.materials import SIGNAL_LAMPS, Material

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.replay import SceneBatch
    from carla_recap.util.arrays import Booleans, Floats, Ids, Indices, Integers


POSITION, LOW_BEAM, HIGH_BEAM, BRAKE, RIGHT_BLINKER, LEFT_BLINKER, REVERSE, FOG = (1 << bit for bit in range(8))
"""Bits of CARLA's VehicleLightState."""
_SPECIAL: Final = 512 | 1024

BRAKING: Final = 0.02
"""The brake control beyond which brake lamps are lit: about 0.2 m/s², less than a driver means by braking."""
HELD: Final = 0.5
"""The time in s for which they stay lit, so that they do not flicker with the control."""
DECELERATION: Final = 1.3
"""The deceleration in m/s² beyond which brake lamps are lit where neither controls nor lights are recorded: from it on,
UN Regulation 13-H has them lit whatever slows the vehicle down."""
_SPAN: Final = 0.3  # s; the time over which a deceleration is a mean
_LONGEST: Final = 1.0  # s; over a longer step there is no deceleration

_LIT_BY: Final = (
    (Material.HEADLIGHT, LOW_BEAM | HIGH_BEAM | FOG),
    (Material.TAIL_LIGHT, POSITION | LOW_BEAM | HIGH_BEAM | BRAKE),
    (Material.BRAKE_LIGHT, BRAKE),
    (Material.LEFT_INDICATOR, LEFT_BLINKER),
    (Material.RIGHT_INDICATOR, RIGHT_BLINKER),
    (Material.REVERSE_LIGHT, REVERSE),
    (Material.BEACON, _SPECIAL),
)
"""The lamps, and the bits of CARLA's VehicleLightState of which any lights them."""
_STATES: Final = np.array([*(1 << lamp for lamp in SIGNAL_LAMPS), 0, 0], np.uint64)
_OFF: Final = 3
_KNOWN_BITS: Final = 0xFFF
_LAMPS_OF_FLAGS: Final = np.array(
    [sum(1 << material for material, bits in _LIT_BY if flags & bits) for flags in range(_KNOWN_BITS + 1)], np.uint64
)


def lamps_of_vehicles(flags: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Return the lit lamps of vehicles, a bit `1 << material` for each, by the bits of CARLA's VehicleLightState."""
    lamps: NDArray[np.uint64] = _LAMPS_OF_FLAGS[flags & _KNOWN_BITS]
    return lamps


def lamps_of_lights(states: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Return the lit lamps of traffic lights, by CARLA's states: 0 red, 1 yellow, 2 green, none of others."""
    lamps: NDArray[np.uint64] = _STATES[np.where((states >= 0) & (states < len(_STATES)), states, -1)]
    return lamps


def state_of_lamps(lamps: int) -> int:
    """Return CARLA's state of a traffic light by its lit lamps, the inverse of `lamps_of_lights`; 3 (off) without any."""
    return next((state for state, lamp in enumerate(SIGNAL_LAMPS) if lamps >> lamp & 1), _OFF)


class VehicleLamps:
    """Decides which lamps of vehicles are lit, from one batch of scenes to the next.

    Lit are those of the recorded light flags; brake lamps also while the brake control is above 0.02, and for 0.5 s after
    it; reversing lamps also in a reverse gear. Of a vehicle that has neither controls nor flags, brake lamps are lit while
    it slows down by more than 1.3 m/s² as a mean of 0.3 s, and for 0.5 s after it.

    Attributes:
        ids: The vehicles of the latest batch, ascending.
    """

    def __init__(self) -> None:
        self.ids: Ids = NO_IDS
        self._actors: Mapping[int, ActorLife] = {}
        self._braked: Floats = np.zeros(0)  # the latest time at which each has braked, in elapsed seconds
        self._slowing = _Slowing()
        self._time = -np.inf  # of the latest scene

    def flags(self, batch: SceneBatch, *, keep: bool = False) -> Integers:
        """Return the lit lamps of the vehicles in each scene, as bits of CARLA's VehicleLightState, (scenes, ids).

        Each batch has to be given, in order; with `keep`, a first batch after a seek follows the one before, nevertheless.
        """
        is_new = (batch.fresh and not keep) or not batch.time[0] >= self._time
        self._time = float(batch.time[-1])
        if is_new or batch.actors != self._actors:
            self._take(batch, forget=is_new)
        flags = np.zeros((len(batch), len(self.ids)), np.int64)
        if not len(self.ids):
            return flags
        silent = np.ones(len(self.ids), np.bool_)  # those without recorded flags and controls
        lights = batch.frames.records("vehicle_lights")
        known, where = self._columns(lights)
        if len(known):
            silent[known] = False
            flags[:, known] = lights["flags"][:, where]
        controls = batch.frames.records("vehicle_controls")
        known, where = self._columns(controls)
        if len(known):
            silent[known] = False
            self._brake(batch, known, controls["brake"][:, where] > BRAKING, flags)
            reversing = controls["gear"] < 0
            if reversing.any():
                flags[:, known] |= np.where(reversing[:, where], REVERSE, 0)
        if silent.any():
            _, recorded = find(self.ids, batch.ids)
            known = np.flatnonzero(silent & recorded)
            if len(known):
                self._brake(batch, known, self._slowing.brakes(batch, self.ids[known]), flags)
        return flags

    def flags_at(self, time: float, ids: Ids, lights: NDArray[np.integer], brakes: Floats, reversing: Booleans) -> Integers:
        """Return the lit lamps of the vehicles of a running simulation at a moment, as `flags` does.

        The moment, in elapsed seconds, is later than those before. Brake controls are from 0 to 1.
        """
        if not np.array_equal(ids, self.ids):
            order = np.argsort(self.ids)
            index, known = find(ids, self.ids[order])
            braked = np.full(len(ids), -np.inf)
            braked[known] = self._braked[order[index[known]]]
            self.ids, self._braked = ids, braked
        if time < self._time:
            self._braked[:] = -np.inf
        self._time = time
        self._braked[brakes > BRAKING] = time
        return lights.astype(np.int64) | np.where(time - self._braked < HELD, BRAKE, 0) | np.where(reversing, REVERSE, 0)

    def _take(self, batch: SceneBatch, *, forget: bool) -> None:
        """Take the vehicles of a batch."""
        self._actors = batch.actors
        spawned = {event.actor.id for event in batch.events if isinstance(event, Spawned)} if not batch.fresh else set()
        before, braked = self.ids, self._braked
        self.ids = np.array(sorted(id for id, actor in batch.actors.items() if actor.kind == "vehicle"), np.uint32)
        self._braked = np.full(len(self.ids), -np.inf)
        if forget:
            self._slowing = _Slowing()
        else:
            index, known = find(self.ids, before)
            self._braked[known] = braked[index[known]]
        if spawned:
            self._braked[np.isin(self.ids, list(spawned))] = -np.inf
            self._slowing.forget(spawned)

    def _brake(self, batch: SceneBatch, known: Indices, braking: Booleans, flags: Integers) -> None:
        """Light the brake lamps of some vehicles, given when these brake, (scenes, vehicles)."""
        if not braking.any() and not (batch.time[0] - self._braked[known] < HELD).any():
            return
        braked = np.where(braking, batch.frames.elapsed[:, None], -np.inf)
        braked = np.maximum.accumulate(np.concatenate((self._braked[None, known], braked)))[1:]
        self._braked[known] = braked[-1]
        flags[:, known] |= np.where(batch.time[:, None] - braked < HELD, BRAKE, 0)

    def _columns(self, records: NDArray[np.void]) -> tuple[Indices, Indices]:
        """Return the indices of the vehicles that have records, and the columns of the last record of each."""
        nothing = np.zeros(0, np.intp)
        if not records.size:
            return nothing, nothing
        recorded = records["id"][0]
        order = np.argsort(recorded, kind="stable")
        last = np.searchsorted(recorded[order], self.ids, "right") - 1
        columns = order[last]
        known = np.flatnonzero((last >= 0) & (recorded[columns] == self.ids))
        return known, columns[known]


class _Slowing:
    """Whether vehicles slow down as by brakes, by their velocities (`carla_recap.model.motion`)."""

    def __init__(self) -> None:
        self._ids: Ids = NO_IDS
        self._time: Floats = np.zeros(0)  # of the last frames
        self._motion: Floats = np.zeros((0, 0, 6))  # what `recorded_motion` returns of them
        self._latest: Booleans = np.zeros(0, np.bool_)

    def forget(self, ids: set[int]) -> None:
        """Forget where some vehicles were."""
        self._motion[:, np.isin(self._ids, list(ids))] = np.nan

    def brakes(self, batch: SceneBatch, ids: Ids) -> Booleans:
        """Return whether vehicles, whose ids ascend, slow down in each scene, (scenes, ids)."""
        if not np.isin(ids, self._ids).all():
            every = np.union1d(ids, self._ids[np.isin(self._ids, list(batch.actors))])
            index, known = find(every, self._ids)
            motion, latest = np.full((len(self._time), len(every), 6), np.nan), np.zeros(len(every), np.bool_)
            motion[:, known], latest[known] = self._motion[:, index[known]], self._latest[index[known]]
            self._ids, self._motion, self._latest = every, motion, latest
        those, held = np.searchsorted(self._ids, ids), len(self._time)
        if held and not (batch.frames.elapsed > self._time[-1]).all():  # scenes within a frame that is known
            return np.broadcast_to(self._latest[those], (len(batch), len(ids)))
        time, motion = recorded_motion(batch, self._ids)
        time, motion = np.concatenate((self._time, time)), np.concatenate((self._motion, motion))
        actor, frame = np.nonzero(np.isfinite(motion[..., 0]).T)
        flat, speed = motion[frame, actor].T, np.full(motion.shape[:2], np.nan)
        first, last = _spans(time[:-1], held)
        slows = np.zeros((len(time) - 1, len(self._ids)), np.bool_)
        with np.errstate(all="ignore"):
            velocities, _ = motion_of(time[frame], flat[:3], flat[3:], actor)
            speed[frame, actor] = np.hypot(*velocities[:2])
            # Of the latest frame up to each that has the actor:
            seen = np.maximum.accumulate(np.where(np.isfinite(speed), np.arange(len(speed))[:, None], 0), axis=0)
            speed, at = np.take_along_axis(speed, seen, axis=0), time[seen]
            seconds = at[last] - at[first]
            deceleration = (speed[first] - speed[last]) / seconds
            slows[last] = (deceleration > DECELERATION) & (deceleration < MAX_DECELERATION) & (seconds <= _LONGEST)
        kept = max(min(int(np.searchsorted(time[:-1], time[-2] - _SPAN)), len(time) - 2) - 1, 0)  # with the frame before
        self._time, self._motion, self._latest = time[kept:-1], motion[kept:-1], slows[-1]
        return slows[held:, those]


def _spans(time: Floats, held: int) -> tuple[Indices, Indices]:
    """Return the first and the last frames of spans of about 0.3 s up to each time but the first ones."""
    last = np.arange(max(held, 1), len(time))
    return np.clip(np.searchsorted(time, time[last] - _SPAN), 0, last - 1), last
