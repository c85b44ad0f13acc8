"""The lamps of vehicles: brake lights, indicators and others, while they are lit."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.replay.selection import NO_IDS, find
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.meshes import lamps_of, unlit
from carla_recap.show.rerun.stream import TimeColumns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay.selection import Ids
    from carla_recap.scene.description import SceneDescription
    from carla_recap.scene.mesh import Mesh
    from carla_recap.show.rerun.stream import Stream, TimePoint

    Lamps = NDArray[np.uint64]

_LAMPS: Final = (
    Material.BRAKE_LIGHT,
    Material.TAIL_LIGHT,
    Material.LEFT_INDICATOR,
    Material.RIGHT_INDICATOR,
    Material.REVERSE_LIGHT,
    Material.HEADLIGHT,
    Material.BEACON,
)
_MAX_CHANGES: Final = 8192  # the number of changes that are held back


class LampWriter:
    """Writes the lamps of vehicles whenever they change: an entity for each kind of lamp that is ever lit.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._meshes: dict[int, Mesh] = {}
        self._lit: dict[int, dict[Material, bool]] = {}  # whether the lamps of each vehicle that have been lit still are
        self._ids: Ids = NO_IDS
        self._latest: Lamps = np.zeros(0, np.uint64)  # the lit lamps of each in the latest scene
        self._changes: defaultdict[tuple[int, Material], list[tuple[TimePoint, bool]]] = defaultdict(list)
        self._count = 0

    def add(self, id: int, mesh: Mesh) -> None:
        """Add a vehicle, of which nothing is lit."""
        self.remove(id)
        self._meshes[id] = mesh
        where = int(self._ids.searchsorted(id))
        self._ids, self._latest = np.insert(self._ids, where, id), np.insert(self._latest, where, 0)

    def remove(self, id: int) -> None:
        """Forget a vehicle."""
        self._lit.pop(id, None)
        if self._meshes.pop(id, None) is not None:
            kept = self._ids != id
            self._ids, self._latest = self._ids[kept], self._latest[kept]

    def write(self, description: SceneDescription, times: TimeColumns) -> None:
        """Write scenes."""
        index, known = find(self._ids, description.ids)
        lamps = description.lamps[:, index]
        if not known.all():
            lamps[:, ~known] = 0
        changed = lamps != np.concatenate((self._latest[None], lamps[:-1]))
        self._latest = lamps[-1]
        rows, columns = np.nonzero(changed)
        for row, id, lit in zip(rows.tolist(), self._ids[columns].tolist(), lamps[rows, columns].tolist(), strict=True):
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
