"""The lamps of vehicles: brake lights, indicators and others, while they are lit."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.scene.actors import BRAKE, LEFT_BLINKER, REVERSE, RIGHT_BLINKER, lamps_of_vehicles
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.meshes import lamps_of, unlit
from carla_recap.show.rerun.stream import TimeColumns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay import SceneBatch
    from carla_recap.replay.selection import Ids
    from carla_recap.scene.mesh import Mesh
    from carla_recap.show.rerun.stream import Stream, TimePoint

    Flags = NDArray[np.int64]
    Indices = NDArray[np.intp]

_LAMPS: Final = (
    Material.BRAKE_LIGHT,
    Material.TAIL_LIGHT,
    Material.LEFT_INDICATOR,
    Material.RIGHT_INDICATOR,
    Material.REVERSE_LIGHT,
    Material.HEADLIGHT,
    Material.BEACON,
)
_BRAKING: Final = 0.02  # of the brake control, from which on the lamps are lit
_HELD: Final = 0.5  # s for which they stay lit, so that they do not flicker at a standstill
_NOTHING: Final = np.zeros(0, np.intp)
_MAX_CHANGES: Final = 8192  # the number of changes that are held back
_ALL_BITS: Final = 0xFFF | BRAKE | LEFT_BLINKER | RIGHT_BLINKER | REVERSE


class LampWriter:
    """Writes the lamps of vehicles whenever they change: an entity for each kind of lamp that is ever lit.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._meshes: dict[int, Mesh] = {}
        self._lit: dict[int, dict[Material, bool]] = {}  # whether the lamps of each vehicle that have been lit still are
        self._ids: Ids = np.zeros(0, np.uint32)
        self._flags = np.zeros(0, np.int64)  # the latest ones of each
        self._braked = np.zeros(0)  # the latest times in elapsed seconds
        self._found: dict[str, tuple[bytes, Indices, Indices]] = {}  # the last answers of `_columns`
        self._changes: defaultdict[tuple[int, Material], list[tuple[TimePoint, bool]]] = defaultdict(list)
        self._count = 0

    def add(self, id: int, mesh: Mesh) -> None:
        """Add a vehicle, of which nothing is lit."""
        self.remove(id)
        self._meshes[id] = mesh
        self._found.clear()
        where = int(self._ids.searchsorted(id))
        self._ids = np.insert(self._ids, where, id)
        self._flags, self._braked = np.insert(self._flags, where, 0), np.insert(self._braked, where, -np.inf)

    def remove(self, id: int) -> None:
        """Forget a vehicle."""
        self._lit.pop(id, None)
        if self._meshes.pop(id, None) is not None:
            self._found.clear()
            kept = self._ids != id
            self._ids, self._flags, self._braked = self._ids[kept], self._flags[kept], self._braked[kept]

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        if not len(self._ids):
            return
        flags = self._flags_of(batch)
        changed = flags != np.concatenate((self._flags[None], flags[:-1]))
        self._flags = flags[-1]
        if not changed.any():
            return
        rows, columns = np.nonzero(changed)
        lamps = lamps_of_vehicles(flags[rows, columns]).tolist()
        for row, id, lit in zip(rows.tolist(), self._ids[columns].tolist(), lamps, strict=True):
            self._change(id, lit, times.point(row))
        if self._count >= _MAX_CHANGES:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        for (id, material), changes in self._changes.items():
            finish = MATERIALS[material]
            colors = np.array([(finish.glow or finish.color) if lit else finish.color for _, lit in changes], np.uint8)
            times = TimeColumns.of_points(time for time, _ in changes)
            self._stream.columns(paths.lamps(id, material.name), times, rr.Mesh3D.columns(albedo_factor=colors))
        self._changes.clear()
        self._count = 0

    def _flags_of(self, batch: SceneBatch) -> Flags:
        """Return the bits of CARLA's VehicleLightState of all vehicles, (scenes, vehicles)."""
        flags = np.zeros((len(batch), len(self._ids)), np.int64)
        lights = batch.frames.records("vehicle_lights")
        known, where = self._columns("vehicle_lights", lights)
        if len(known):
            flags[:, known] = lights["flags"][:, where] & _ALL_BITS
        controls = batch.frames.records("vehicle_controls")
        known, where = self._columns("vehicle_controls", controls)
        if len(known):
            times = batch.time[:, None]
            braking = (controls["brake"] > _BRAKING)[:, where]
            if braking.any() or (batch.time[0] - self._braked[known] < _HELD).any():
                braked = np.where(braking, times, -np.inf)
                braked = np.maximum.accumulate(np.concatenate((self._braked[None, known], braked)))[1:]
                self._braked[known] = braked[-1]
                flags[:, known] |= np.where(times - braked < _HELD, BRAKE, 0)
            reversing = controls["gear"] < 0
            if reversing.any():
                flags[:, known] |= np.where(reversing[:, where], REVERSE, 0)
        return flags

    def _columns(self, name: str, records: NDArray[np.void]) -> tuple[Indices, Indices]:
        """Return the indices of the vehicles that have records, and the columns of the last record of each."""
        if not records.size:
            return _NOTHING, _NOTHING
        recorded = records["id"][0]
        key = recorded.tobytes()
        if self._found.get(name, (b"",))[0] != key:
            order = np.argsort(recorded, kind="stable")
            last = np.searchsorted(recorded[order], self._ids, "right") - 1
            columns = order[last]
            known = np.flatnonzero((last >= 0) & (recorded[columns] == self._ids))
            self._found[name] = key, known, columns[known]
        _, known, columns = self._found[name]
        return known, columns

    def _change(self, id: int, lamps: int, time: TimePoint) -> None:
        """Note the lit lamps of a vehicle, given as bits `1 << material`."""
        states = self._lit.setdefault(id, {})
        for material in _LAMPS:
            lit = bool(lamps >> material & 1)
            if lit == states.get(material, False):
                continue
            if material not in states:
                mesh = lamps_of(self._meshes[id], material)
                if mesh is None:
                    continue
                self._stream.log(paths.lamps(id, material.name), time, unlit(mesh))
            states[material] = lit
            self._changes[id, material].append((time, lit))
            self._count += 1
