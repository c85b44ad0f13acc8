"""Tracks as CSV: a row for each vehicle and walker in each frame, with its size and its velocity."""

from __future__ import annotations

import csv
import math
import warnings
from io import StringIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.editing.convert import check_destination
from carla_recap.errors import RecapWarning
from carla_recap.model.lives import ROAD_USERS
from carla_recap.replay import Played, Player
from carla_recap.replay.pose import right_handed
from carla_recap.scene.appearance import look_of_present
from carla_recap.util.files import WholeFile
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from carla_recap.model.lives import ActorLife
    from carla_recap.recording import Recording
    from carla_recap.replay.player import Progress
    from carla_recap.replay.scene import SceneBatch

COLUMNS: Final = (
    *("time", "id", "kind", "type_id", "role_name"),
    *("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz"),
    *("length", "width", "height", "box_x", "box_y", "box_z"),
)
"""Time in s; positions and sizes in m, angles in degrees, velocities in m/s, in right-handed axes."""


def export_csv(
    source: Recording,
    destination: Path | str,
    *,
    start: float = 0.0,
    duration: float = 0.0,
    force: bool = False,
    progress: Progress | None = None,
) -> Played:
    """Write the tracks of vehicles and walkers as a CSV file; see `export`.

    Numbers have as many digits as it takes to read the same ones again: `import_tracks` gives the same transforms. A
    velocity that was not recorded, or is not finite, is empty. Poses that are not finite are left out, of which a
    `RecapWarning` tells, or that there are none. Return the number of frames, and the seconds that they span.
    """
    reader = source.reader
    check_destination(reader.location, destination, force=force)
    player = Player(source, start=start, duration=duration)
    frames, first, last = 0, player.start, player.start
    poses = left_out = 0
    with WholeFile(destination, force=force) as file:
        file.write((",".join(COLUMNS) + "\n").encode())
        for batch in player.batches(progress):
            text, rows = StringIO(), list(_rows(batch))
            known = [row for row in rows if row is not None]
            csv.writer(text, lineterminator="\n").writerows(known)
            poses, left_out = poses + len(rows), left_out + len(rows) - len(known)
            file.write(text.getvalue().encode("utf-8", "backslashreplace"))
            first = float(batch.time[0]) if not frames else first
            frames, last = frames + len(batch), float(batch.time[-1])
    if left_out or not poses:
        what = f"{left_out} of {poses} poses are not finite, and left out" if poses else "no vehicle or walker has a pose"
        warnings.warn(f"{destination}: {what}", RecapWarning, stacklevel=2)
    return Played(frames, last - first)


def _rows(batch: SceneBatch) -> Iterator[list[object] | None]:
    """Yield the rows of scenes, in the order of time; None for poses that are not finite."""
    actors = [(column, actor) for column, id in enumerate(batch.ids.tolist()) if (actor := _actor(batch, id))]
    poses = right_handed(batch.poses) + 0.0  # no -0.0
    recorded = batch.records("velocities")
    with np.errstate(invalid="ignore"):
        velocities = np.stack([recorded[axis].astype(np.float64) for axis in "xyz"], axis=2) * (1.0, -1.0, 1.0) + 0.0
    known = {id: column for column, id in enumerate(recorded["id"][0].tolist())} if recorded.shape[1] else {}
    columns = []
    for column, actor in actors:
        look = look_of_present(actor)
        half, center = (look.half_extents, look.center) if look else ((0.0,) * 3, (0.0,) * 3)
        head = [actor.id, actor.kind, visible(actor.type_id), visible(actor.role_name)]
        columns.append((column, head, [*(_rounded(2 * extent) for extent in half), *map(_rounded, center)]))
    finite: Any = np.isfinite(poses).all(axis=2)
    for row, time in enumerate(batch.time.tolist()):
        for column, head, size in columns:
            if not finite[row, column]:
                yield None
                continue
            moving = velocities[row, known[head[0]]].tolist() if head[0] in known else [math.nan]
            is_known = all(map(math.isfinite, moving))
            yield [time, *head, *poses[row, column].tolist(), *(moving if is_known else [""] * 3), *size]


def _actor(batch: SceneBatch, id: int) -> ActorLife | None:
    """Return a vehicle or a walker; None for another actor."""
    actor = batch.actors.get(id)
    return actor if actor is not None and actor.kind in ROAD_USERS else None


def _rounded(metres: float) -> float:
    return round(metres, 6) + 0.0
