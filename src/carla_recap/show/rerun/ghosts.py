"""The actors of another recording as ghosts: see-through models where they are elsewhere than in the recording."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.errors import RecapError
from carla_recap.model.lives import ROAD_USERS
from carla_recap.queries.differences import differences
from carla_recap.replay import Destroyed, Player, Spawned
from carla_recap.scene import style
from carla_recap.scene.description import SceneDescriber
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.bodies import MOST_MODELS
from carla_recap.show.rerun.meshes import faded, mesh3d, model_mesh
from carla_recap.show.rerun.stream import PoseBuffer, Stream, TimeColumns, TimePoint, screen_radii

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorLife
    from carla_recap.replay import SceneBatch
    from carla_recap.scene.description import SceneDescription

APART: Final = 0.1
"""The distance in m from which on an actor has a ghost."""

COLOR: Final = (209, 140, 255)
_OPACITY: Final = 0.25
_RADIUS: Final = 2.5  # points of the screen; of a ghost on the map


def write_ghosts(
    recording: rr.RecordingStream, source: Reader, ghost: Reader, *, start: float, duration: float, follow: int | None = None
) -> None:
    """Write the vehicles and walkers of another recording, each from when on its path parts; that of `follow` has a name."""
    found = differences(source, ghost, tolerance=APART, events=False)
    shown = {(row.id_b, row.spawned_at_b): row.first for row in found.actors if row.first is not None}
    shown |= {(actor.id, actor.spawned_at): -math.inf for actor in found.extra}
    named = {(row.id_b, row.spawned_at_b) for row in found.actors if row.id_a == follow or row.role_name == "hero"}
    try:
        player = Player(ghost, start=start, duration=duration)
    except RecapError:  # it ends before
        return
    writer = GhostWriter(Stream(recording), shown, named)
    for batch in player.batches():
        writer.write(batch)
    writer.close()


class GhostWriter:
    """Writes ghosts: an actor, by its id and its spawn, is shown from some elapsed seconds on; some have names."""

    def __init__(self, stream: Stream, shown: dict[tuple[int, float], float], named: set[tuple[int, float]]) -> None:
        self._stream = stream
        self._shown, self._named = shown, named
        self._waiting: dict[int, tuple[float, ActorLife]] = {}
        self._begun: dict[int, ActorLife] = {}
        self._drawn: set[int] = set()  # of these, those that are somewhere to be seen
        self._describer = SceneDescriber()
        self._poses = PoseBuffer()
        self._last: TimePoint | None = None
        stream.log_static(entities.MAP_GHOSTS, rr.Points2D.from_fields(radii=screen_radii(_RADIUS), colors=[COLOR]))

    def write(self, batch: SceneBatch) -> None:
        """Write scenes."""
        for event in batch.events:
            if isinstance(event, Spawned):
                self._erase(event.actor.id, batch)
                key = event.actor.id, event.actor.spawned_at
                if (
                    key in self._shown
                    and event.actor.kind in ROAD_USERS
                    and len(self._begun) + len(self._waiting) < MOST_MODELS
                ):
                    self._waiting[event.actor.id] = self._shown[key], event.actor
            elif isinstance(event, Destroyed):
                self._erase(event.id, batch)
        begins = (int(np.searchsorted(batch.time, since)) for since, _ in self._waiting.values())
        for start, stop in pairwise(sorted({0, *begins, len(batch)})):
            self._write(batch[start:stop])

    def _write(self, batch: SceneBatch) -> None:
        """Write scenes, within which no ghost begins."""
        times, description = TimeColumns.of(batch), self._describer.describe(batch)
        self._last = times.point(-1)
        begun = [id for id, (since, _) in self._waiting.items() if since <= batch.time[0] and batch.index_of(id) is not None]
        if begun:
            self.flush()
        self._begun |= {id: self._waiting.pop(id)[1] for id in begun}
        shown = description.recorded_shown & np.isin(batch.ids, list(self._begun))
        changed = shown != np.concatenate((np.isin(batch.ids, list(self._drawn))[None], shown[:-1]))
        for row, column in zip(*(index.tolist() for index in np.nonzero(changed)), strict=True):
            id = int(batch.ids[column])
            if shown[row, column]:
                self._draw(self._begun[id], description, times.point(row))
            else:
                self._stream.clear(f"{entities.GHOSTS}/{id}", times.point(row))
        self._drawn = self._drawn.difference(batch.ids.tolist()).union(batch.ids[shown[-1]].tolist())
        self._poses.add(description, times, begun)
        if self._poses.is_full:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        block = self._poses.take()
        if block is not None:
            block.write(self._stream, self._begun, entities.GHOSTS)
            block.write_points(self._stream, entities.MAP_GHOSTS, self._begun)

    def close(self) -> None:
        """Write what is held back, and remove all ghosts."""
        self.flush()
        if self._last is not None:
            self._stream.clear(entities.GHOSTS, self._last)
            self._stream.clear(entities.MAP_GHOSTS, self._last)

    def _draw(self, actor: ActorLife, description: SceneDescription, time: TimePoint) -> None:
        look = description.actors.look_of(actor.id)
        if look is None:
            return
        mesh = model_mesh(look)
        body = mesh3d(mesh, np.full((len(mesh.vertices), 3), COLOR, np.uint8))
        archetypes: list[rr.AsComponents] = [body, rr.Mesh3D.from_fields(albedo_factor=faded(_OPACITY))]
        if (actor.id, actor.spawned_at) in self._named:
            above = (look.center[0], look.center[1], look.center[2] + look.half_extents[2])
            name = f"B: {style.label_of(actor)}"
            archetypes.append(rr.Points3D([above], colors=[COLOR], radii=[0], labels=[name], show_labels=True))
        self._stream.log(f"{entities.GHOSTS}/{actor.id}", time, *archetypes)

    def _erase(self, id: int, batch: SceneBatch) -> None:
        self._waiting.pop(id, None)
        if id in self._begun:
            self.flush()
            del self._begun[id]
            self._drawn.discard(id)
            self._stream.clear(f"{entities.GHOSTS}/{id}", TimeColumns.of(batch).point(0))
