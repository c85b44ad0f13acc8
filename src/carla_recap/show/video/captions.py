"""The captions of a video: what they say about its incidents, and when."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.kinds import KINDS
from carla_recap.scene.captions import caption_of
from carla_recap.show.video.overlay import Caption

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from carla_recap.queries.incidents import Incident

_SHOWN: Final = 3.5  # s of the video for which a caption is shown, at least
_FADE: Final = 0.4  # s of the video, in which it fades
_PATIENCE: Final = 2.0  # s after which a long stop is mentioned
_NEAR: Final = 70.0  # m; incidents of others are mentioned if they are no farther away
_MOST: Final = 2  # captions at a time


class Captions:
    """The incidents that a video shows.

    Args:
        incidents: The incidents of the recording.
        start: The elapsed seconds of the first picture.
        stop: The elapsed seconds of the last picture.
        speed: The seconds of the recording in a second of the video.
        followed: The followed actor, if any.
    """

    def __init__(
        self, incidents: Iterable[Incident], *, start: float, stop: float, speed: float = 1.0, followed: int | None = None
    ) -> None:
        self._start, self._stop = start, stop
        self._speed = speed
        self._followed = followed
        shown = [each for each in incidents if each.start <= stop + SAME_TIME and self._end(each) >= start]
        ranks = {kind: -rank for rank, kind in enumerate(KINDS)}
        shown.sort(key=lambda each: (self._concerns(each), ranks[each.kind], each.start), reverse=True)
        self._incidents = shown

    def marks(self) -> Iterator[tuple[float, str]]:
        """Yield the part of the video, from 0 to 1, at which each incident of the followed actor happens, and its kind."""
        length = self._stop - self._start
        for each in self._incidents:
            if length > 0 and self._start <= each.start <= self._stop and self._concerns(each):
                yield (each.start - self._start) / length, each.kind

    def at(self, time: float, is_near: Callable[[float, float], bool] | None = None) -> tuple[Caption, ...]:
        """Return the captions of a moment, the most important first: those of the followed actor before others.

        Args:
            time: The elapsed seconds.
            is_near: Returns whether a location, x and y in m, is near what the video shows; None: all are.
        """
        found = []
        for each in self._incidents:
            begin, end = self._begin(each), self._end(each)
            if begin - SAME_TIME <= time <= end and (self._concerns(each) or is_near is None or is_near(each.x, each.y)):
                rest = (end - time) / self._speed
                opacity = min(1.0, (rest + 0.05) / _FADE)
                found.append(Caption(each.kind, caption_of(each), round(opacity, 1)))
        return tuple(found[:_MOST])

    def _concerns(self, incident: Incident) -> bool:
        return self._followed is None or self._followed in incident.actors

    def _begin(self, incident: Incident) -> float:
        return incident.start + (_PATIENCE if incident.kind == "blocked" else 0.0)

    def _end(self, incident: Incident) -> float:
        if incident.kind == "blocked" and self._followed in incident.actors:
            return incident.stop
        return max(self._begin(incident) + _SHOWN * self._speed, incident.stop if incident.kind == "hard braking" else 0.0)


def is_near(x: float, y: float) -> Callable[[float, float], bool]:
    """Return a function that returns whether a location is near another one; both are in m."""
    return lambda other_x, other_y: math.hypot(other_x - x, other_y - y) <= _NEAR
