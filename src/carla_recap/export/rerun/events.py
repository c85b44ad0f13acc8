"""What happens, as a log; and collisions as markers in the world, one for each contact."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import look
from carla_recap.export.rerun import tree
from carla_recap.replay import Collided, right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Moment, Stream
    from carla_recap.replay import Event, Present, Scene

_PAUSE: Final = 1.0  # s; what comes sooner after the last record of a contact belongs to it
_SHOWN: Final = 2_000_000_000  # ns; so long a collision is marked
_ABOVE: Final = 2.5  # m; so high above the ground
_MARK: Final = 0.5  # m
_MANY: Final = 8  # so many actors that come or go at once are counted, not named


class Chronicle:
    """Writes the log, and the collisions.

    Args:
        stream: Where to.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._actors: dict[int, Present] = {}
        self._contacts: dict[frozenset[int], float] = {}  # pairs, and when they touched last
        self._marks: list[tuple[int, str]] = []  # what is to disappear, and when, in ns
        self._count = 0

    def enter(self, scene: Scene, moment: Moment) -> None:
        """Take a scene in."""
        if self._marks:
            self._wipe(moment)
        if not scene.events:
            return
        self._actors.update((event.actor.id, event.actor) for event in scene.spawned)
        spawned, destroyed = scene.spawned, scene.destroyed
        if len(spawned) > _MANY:
            verb = "are there" if scene.fresh and moment.elapsed else "appear"
            self._say(moment, _summary([event.actor for event in spawned], verb), rr.TextLogLevel.INFO)
        else:
            self._tell(moment, spawned, rr.TextLogLevel.INFO)
            self._tell(moment, scene.parented, rr.TextLogLevel.DEBUG)
        if len(destroyed) > _MANY:
            gone = [self._actors[event.id] for event in destroyed if event.id in self._actors]
            self._say(moment, _summary(gone, "disappear"), rr.TextLogLevel.INFO)
        else:
            self._tell(moment, destroyed, rr.TextLogLevel.INFO)
        for collision in scene.collisions:
            self._collide(collision, scene, moment)
        for event in destroyed:
            if event.id not in scene.actors:
                self._actors.pop(event.id, None)

    def close(self) -> None:
        """Nothing is held back."""

    def _collide(self, event: Collided, scene: Scene, moment: Moment) -> None:
        pair = frozenset((event.actor1, event.actor2))
        last = self._contacts.get(pair, -np.inf)
        self._contacts[pair] = scene.time
        if scene.time - last < _PAUSE:
            return
        self._contacts = {pair: time for pair, time in self._contacts.items() if scene.time - time < _PAUSE}
        self._tell(moment, [event], rr.TextLogLevel.ERROR)
        poses = [pose for id in (event.actor1, event.actor2) if (pose := scene.pose_of(id)) is not None]
        if poses:
            self._mark(right_handed(np.mean(poses, axis=0))[LOCATION], moment)

    def _mark(self, place: NDArray[np.float64], moment: Moment) -> None:
        path = f"{tree.COLLISIONS}/{self._count}"
        self._count += 1
        self._marks.append((moment.elapsed + _SHOWN, path))
        self._stream.log(
            path,
            moment,
            rr.Points3D(
                [place + np.array((0, 0, _ABOVE)), place + np.array((0, 0, _ABOVE + 2 * _MARK))],
                colors=[look.COLLISION],
                radii=[_MARK, 0],
                labels=["", "collision"],
                show_labels=True,
            ),
        )

    def _wipe(self, moment: Moment) -> None:
        due = [path for time, path in self._marks if time <= moment.elapsed]
        for path in due:
            self._stream.clear(path, moment)
        del self._marks[: len(due)]

    def _tell(self, moment: Moment, events: Iterable[Event], level: rr.TextLogLevel) -> None:
        for event in events:
            self._say(moment, look.sentence(event, self._actors), level)

    def _say(self, moment: Moment, text: str, level: rr.TextLogLevel) -> None:
        self._stream.log(tree.EVENTS, moment, rr.TextLog(text, level=level))


def _summary(actors: Sequence[Present], verb: str) -> str:
    """Many actors in a sentence: `150 actors appear: 60 walkers, 50 vehicles, 40 others`."""
    kinds = Counter(look.style_of(actor).name for actor in actors)
    counts = ", ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in kinds.most_common())
    return f"{len(actors)} actors {verb}: {counts}"
