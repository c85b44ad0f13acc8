"""The recording of what sensors send beside the world.

The data of a sensor arrive in a thread of CARLA's client, which only puts them in a queue; other threads make messages of
them, and the thread that writes the frames of the world writes these, too.
"""

from __future__ import annotations

from collections import Counter, deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from threading import Condition
from time import monotonic
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from carla_recap.sensors.messages import SensorMessages

if TYPE_CHECKING:
    from concurrent.futures import Future
    from types import TracebackType

    from carla_recap.capture.observer import Observer
    from carla_recap.capture.rig import RigSensors
    from carla_recap.capture.samples import SensorFrame
    from carla_recap.formats.mcap.writer import McapWriter
    from carla_recap.model.frame import Header
    from carla_recap.sensors.messages import SensorMessage
    from carla_recap.sensors.sensing import Sample

WAITING_LIMIT: Final = 256 << 20
"""The most bytes of sensors' data that wait to be written."""

_THREADS: Final = 2  # that make messages
_LATEST: Final = 1.0  # s for which the data of a tick are waited for, before those that came are written
_LAST: Final = 3.0  # s for which the last data are waited for
_PAUSE: Final = 0.02  # s
_NO_DATA: Final = np.zeros(0)


@dataclass(eq=False)
class _TickSamples:
    """The samples of a tick that are to be written, without their data, and their messages.

    Attributes:
        since: When the first one came, on the monotonic clock.
        size: The bytes of the messages.
    """

    since: float
    size: int = 0
    samples: list[Sample] = field(default_factory=list)
    messages: list[SensorMessage] = field(default_factory=list)


class SampleRecorder:
    """Records what sensors send, while a `with` block runs; `advance` and `finish` write to the writer of the recording.

    In synchronous mode, a sensor's thread waits while too many bytes wait to be written; else its data are dropped. A file
    that cannot be written to is an error; on entry, so is a server that does not answer.

    Attributes:
        counts: The number of written samples of each sensor, by id.
        dropped: The number of samples of each sensor that came while too many bytes waited, by id.
    """

    def __init__(self, observer: Observer, sensors: RigSensors, writer: McapWriter, header: Header) -> None:
        self.counts: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self._observer = observer
        self._sensors = sensors
        self._writer = writer
        self._messages = SensorMessages(sensors.rig, header)
        for topic in self._messages.topics:
            writer.add_topic(topic)
        self._changed = Condition()
        self._waiting: deque[SensorFrame] = deque()  # for threads that make messages of them
        self._size = 0  # bytes of what is to be written, as it came and as messages
        self._newest: dict[str, int] = {}  # the latest frame of each sensor
        self._keeps_all = sensors.is_synchronous
        self._closed = False
        self._pool = ThreadPoolExecutor(_THREADS, "samples")
        self._made: deque[tuple[SensorFrame, Future[tuple[Sample, list[SensorMessage]]]]] = deque()
        self._ticks: dict[int, _TickSamples] = {}  # by frame
        self._first: tuple[int, float] | None = None  # frame and time of the first observed tick
        self._frame = 0  # the latest that is written

    def __enter__(self) -> Self:
        self._sensors.listen(self._offer)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._close()
        self._pool.shutdown(cancel_futures=True)

    def advance(self, frame: int | None = None) -> None:
        """Write what has come of ticks whose frames are written; that with a number is the latest, or None: as before.

        A `RecapError` is raised if the disk is full or broken, or the data of a sensor cannot be read.
        """
        self._frame = self._frame if frame is None else frame
        self._sensors.check()
        self._keeps_all = self._sensors.is_synchronous
        self._submit()
        self._collect()
        self._write()

    def finish(self) -> None:
        """Write all that belongs to written frames; in synchronous mode, wait for what is still to come. See `advance`."""
        end = monotonic() + (_LAST if self._keeps_all and not self._observer.is_gone else 0.0)
        while monotonic() < end and not self._has_all():
            self._submit()
            self._collect()
            with self._changed:
                self._changed.wait(_PAUSE)
        self._close()
        self._submit()
        while self._made:
            self._made[0][1].exception()
            self._collect()
        self._write(everything=True)

    def _has_all(self) -> bool:
        """Return whether all sensors without an interval that have begun to send have sent data of their latest frame."""
        begun = [spec for spec in self._sensors.rig if spec.id in self._newest and not spec.number("sensor_tick")]
        last = self._sensors.last_frames
        return all(self._newest[spec.id] >= min(self._frame, last.get(spec.id, self._frame)) for spec in begun)

    def _close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    # --- in threads of the client ------------------------------------------------------------------------------------------

    def _offer(self, data: SensorFrame) -> None:
        """Take in what a sensor has sent."""
        with self._changed:
            while self._size and self._size + data.size > WAITING_LIMIT and not self._closed:
                if not self._keeps_all:
                    self.dropped[data.spec.id] += 1
                    return
                self._changed.wait(_PAUSE)
            if self._closed:
                return
            self._size += data.size
            self._newest[data.spec.id] = data.frame
            self._waiting.append(data)
            self._changed.notify_all()

    # --- in the thread that writes -----------------------------------------------------------------------------------------

    def _submit(self) -> None:
        """Have messages made of what has come of ticks that were observed."""
        times = self._observer.times
        if not times:
            return
        self._first = self._first or next(iter(times.items()))
        with self._changed:
            waiting, self._waiting = self._waiting, deque()
        latest = self._observer.frame
        early = [data for data in waiting if data.frame > latest]
        for data in waiting:
            if data.frame < self._first[0]:
                self._release(data.size)
            elif data.frame <= latest:
                time = times.get(data.frame, data.timestamp)  # of a tick that was missed: what the sensor says
                self._made.append((data, self._pool.submit(self._make, data, time - self._first[1])))
        with self._changed:
            self._waiting.extendleft(reversed(early))

    def _make(self, data: SensorFrame, elapsed: float) -> tuple[Sample, list[SensorMessage]]:
        """Return a sample without its data, and its messages."""
        sample = data.sample(elapsed, np.array(sorted(self._observer.present), np.uint32))
        messages = list(self._messages.of_sample(sample))
        return replace(sample, data=_NO_DATA), messages

    def _collect(self) -> None:
        """Take the messages that are made, in the order in which the data came."""
        while self._made and self._made[0][1].done():
            data, made = self._made.popleft()
            sample, messages = made.result()
            size = sum(len(message.data) for message in messages)
            tick = self._ticks.setdefault(data.frame, _TickSamples(monotonic()))
            tick.samples.append(sample)
            tick.messages += messages
            tick.size += size
            self._release(data.size - size)

    def _write(self, *, everything: bool = False) -> None:
        """Write the samples of ticks that have all, or that have been waited for."""
        before = monotonic() - _LATEST
        for frame in sorted(self._ticks):
            tick = self._ticks[frame]
            is_full = self._size > WAITING_LIMIT // 2
            is_due = everything or is_full or tick.since < before or len(tick.samples) >= self._sensors.count
            if frame > self._frame or not is_due:
                break
            for message in (*tick.messages, *self._messages.poses(tick.samples)):
                self._writer.write_message(*message)
            self.counts.update(sample.spec.id for sample in tick.samples)
            del self._ticks[frame]
            self._release(tick.size)

    def _release(self, size: int) -> None:
        """Make room for data."""
        with self._changed:
            self._size -= size
            self._changed.notify_all()
