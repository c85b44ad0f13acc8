"""The lamps of vehicles: brake lights, indicators and others, while they are lit."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export.rerun import paths
from carla_recap.export.rerun.meshes import lamps_of, unlit
from carla_recap.export.rerun.stream import TimeColumns
from carla_recap.rendering.actors import BRAKE, LEFT_BLINKER, REVERSE, RIGHT_BLINKER, lamps_of_vehicles
from carla_recap.rendering.materials import MATERIALS, Material
from carla_recap.replay.selection import find

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream, TimePoint
    from carla_recap.rendering.mesh import Mesh
    from carla_recap.replay import SceneBatch
    from carla_recap.replay.selection import Ids

    Flags = NDArray[np.int64]

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
        self._flags: dict[int, int] = {}  # the latest ones
        self._braked: dict[int, float] = {}  # the latest times in elapsed seconds
        self._ids: Ids = np.zeros(0, np.uint32)
        self._changes: defaultdict[tuple[int, Material], list[tuple[TimePoint, bool]]] = defaultdict(list)
        self._count = 0

    def add(self, id: int, mesh: Mesh) -> None:
        """Add a vehicle, of which nothing is lit."""
        self.remove(id)
        self._meshes[id] = mesh
        self._ids = np.array(sorted(self._meshes), np.uint32)

    def remove(self, id: int) -> None:
        """Forget a vehicle."""
        if self._meshes.pop(id, None) is not None:
            self._ids = np.array(sorted(self._meshes), np.uint32)
        for known in (self._lit, self._flags, self._braked):
            known.pop(id, None)

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        if not len(self._ids):
            return
        flags = self._flags_of(batch)
        before = np.array([self._flags.get(id, 0) for id in self._ids.tolist()])
        changed = np.concatenate((flags[:1] != before, flags[1:] != flags[:-1]))
        rows, columns = np.nonzero(changed)
        if not len(rows):
            return
        lamps = lamps_of_vehicles(flags[rows, columns]).tolist()
        for row, id, lit in zip(rows.tolist(), self._ids[columns].tolist(), lamps, strict=True):
            self._change(id, lit, times.point(row))
        self._flags.update(zip(self._ids.tolist(), flags[-1].tolist(), strict=True))
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
        lights = batch.records("vehicle_lights")
        if lights.shape[1]:
            where, known = find(self._ids, lights["id"][0])
            flags[:, known] = lights["flags"][:, where[known]] & _ALL_BITS
        controls = batch.records("vehicle_controls")
        if controls.shape[1]:
            where, known = find(self._ids, controls["id"][0])
            ids = self._ids[known].tolist()
            latest = np.array([[self._braked.get(id, -np.inf) for id in ids]])
            times = batch.time[:, None]
            braked = np.where(controls["brake"][:, where[known]] > _BRAKING, times, -np.inf)
            braked = np.maximum.accumulate(np.concatenate((latest, braked)))[1:]
            self._braked.update(zip(ids, braked[-1].tolist(), strict=True))
            is_braking = (times - braked < _HELD).astype(np.int64)
            backwards = (controls["gear"][:, where[known]] < 0).astype(np.int64)
            flags[:, known] |= BRAKE * is_braking | REVERSE * backwards
        return flags

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
