"""Traffic lights: a lamp in the world, and a lane of states, both only when they change."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import style
from carla_recap.export.rerun import tree
from carla_recap.export.rerun.stream import Times
from carla_recap.replay import Destroyed, right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from carla_recap.export.rerun.stream import Moment, Stream
    from carla_recap.replay import Scene

_HELD: Final = 8192  # so many changes are held back at the most


class Signals:
    """Writes the traffic lights.

    Args:
        stream: Where to.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._seen: tuple[bytes, bytes] = (b"", b"")  # ids and states of the last scene
        self._states: dict[int, int] = {}
        self._changes: defaultdict[int, list[tuple[Moment, int]]] = defaultdict(list)
        self._held = 0

    def enter(self, scene: Scene, moment: Moment) -> None:
        """Take a scene in."""
        for event in scene.destroyed:
            if event.id in self._states:
                self._put_out(event, moment)
        records = scene.light_states
        seen = records["id"].tobytes(), records["state"].tobytes()
        if seen == self._seen:
            return
        self._seen = seen
        for id, state in zip(records["id"].tolist(), records["state"].tolist(), strict=True):
            before = self._states.get(id)
            if before == state:
                continue
            if before is None:
                self._put_up(id, scene, moment)
            self._states[id] = state
            self._changes[id].append((moment, state))
            self._held += 1
        if self._held >= _HELD:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        for id, changes in self._changes.items():
            times = Times.of(moment for moment, _ in changes)
            names, colors = zip(*(style.light(state) for _, state in changes), strict=True)
            self._stream.columns(tree.state(id), times, rr.StateChange.columns(state=names))
            self._stream.columns(tree.lamp(id), times, rr.Points3D.columns(colors=np.array(colors, np.uint8)))
        self._changes.clear()
        self._held = 0

    def _put_up(self, id: int, scene: Scene, moment: Moment) -> None:
        names, colors = zip(*style.LIGHTS, strict=True)
        self._stream.always(tree.state(id), rr.StateConfiguration(values=names, colors=colors))
        pose = scene.pose_of(id)
        if pose is None:
            return
        foot = right_handed(pose)[LOCATION]
        top = foot + np.array((0, 0, style.LAMP_UP))
        self._stream.log(
            tree.lamp(id),
            moment,
            rr.Points3D.from_fields(positions=[top], radii=[style.LAMP / 2]),
            rr.LineStrips3D([[foot, top]], colors=[style.POLE], radii=[style.POLE_WIDTH / 2]),
        )

    def _put_out(self, event: Destroyed, moment: Moment) -> None:
        self.flush()
        del self._states[event.id]
        self._stream.clear(tree.lamp(event.id), moment)
        self._stream.clear(tree.state(event.id), moment)
