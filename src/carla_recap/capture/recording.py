"""Records a server from outside into a file, as CARLA's own recorder would."""

from __future__ import annotations

import math
import time
from collections import deque
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from carla_recap.capture.observer import HOST, PORT, Observer
from carla_recap.editing.author import packets_of
from carla_recap.editing.convert import check_new
from carla_recap.editing.recover import finish_partial
from carla_recap.errors import RecapError
from carla_recap.formats import create_writer, format_of
from carla_recap.model.frame import LAST_FRAME_DURATION, Frame, Header, Packet
from carla_recap.model.lives import HERO
from carla_recap.model.records import FRAME_END, UE4

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from carla_recap.capture.observer import Observation
    from carla_recap.capture.rig import RigSensors, Sensors
    from carla_recap.capture.sample_recorder import SampleRecorder
    from carla_recap.model.lives import ActorName

    Progress = Callable[[Iterable[float]], Iterable[float]]

_END: Final = Packet(FRAME_END, UE4[FRAME_END], b"")
_DONE: Final = "the duration has passed"
_ROUNDING: Final = 1e-6  # s: sums of ticks are not exact


class Captured(NamedTuple):
    """What was captured.

    Attributes:
        frames: The number of frames.
        seconds: The elapsed time of the last one, in s.
        missed: The number of ticks that are not in it, because they came too fast.
        why: The reason of its end, in words.
        samples: The number of samples of each sensor, by id.
        dropped: The number of samples of each sensor that came too fast to be written, by id.
        is_cut_short: Whether it has ended since a sensor of the rig, its carrier, or all existing sensors are gone.
    """

    frames: int
    seconds: float
    missed: int
    why: str
    samples: Mapping[str, int]
    dropped: Mapping[str, int]
    is_cut_short: bool


def capture(
    destination: Path | str,
    *,
    host: str = HOST,
    port: int = PORT,
    duration: float = math.inf,
    additional_data: bool = False,
    sensors: Sensors | None = None,
    actor: ActorName = HERO,
    force: bool = False,
    progress: Progress | None = None,
) -> Captured:
    """Record a CARLA server, as one of its clients; the world is never ticked.

    A hero that has no collision sensor gets one until the end; it is not in the recording. Ctrl-C, SIGTERM, a new episode
    and the end of the server complete the recording; so does the end of a sensor of the rig, or of its carrier.

    Args:
        destination: The recording; its suffix, .mcap or .log, is that of the format.
        host: The address of the server.
        port: Its port.
        duration: The simulated seconds after which it ends.
        additional_data: Record velocities, boxes, physics and the times of lights, too.
        sensors: A rig, whose sensors are spawned, recorded, and destroyed at the end; "existing": those that are there are
            recorded. Either needs an .mcap.
        actor: The actor that carries the rig: an id, or "hero".
        force: Overwrite an existing file.
        progress: Wraps the elapsed seconds of the frames, and yields them.

    Raises:
        RecapError: There is no server, no such actor, or a sensor cannot be spawned; or the recording cannot be written:
            what was captured until then is kept, and the message contains its path.
        MissingExtra: An optional dependency is not installed.

    Warns:
        RecapWarning: The server does not know an attribute of a sensor, an existing sensor is left out or gone, or samples
            are dropped.
    """
    check_new(destination, force=force)
    if sensors is not None and format_of(destination) != ".mcap":
        raise RecapError(f"{destination}: has no place for what sensors send; an .mcap was expected")
    with ExitStack() as stack:
        observer = stack.enter_context(Observer(host, port, additional_data=additional_data, attach=True))
        stack.enter_context(observer.until_signal())
        rig: RigSensors | None = None
        if sensors is not None:
            from carla_recap.capture.rig import RigSensors
            from carla_recap.capture.sample_recorder import SampleRecorder
            from carla_recap.formats.mcap.writer import McapWriter

            rig = stack.enter_context(RigSensors(observer, sensors, actor))
        else:
            observer.begin()
        header = header_of(observer)
        writer = create_writer(Path(destination), header, live=True)
        samples: SampleRecorder | None = None
        try:
            with ExitStack() as listening:
                if rig is not None:
                    assert isinstance(writer, McapWriter)
                    samples = listening.enter_context(SampleRecorder(observer, rig, writer, header))
                    observer.begin()  # no frame is older than the first samples
                observations = until(duration, observer, _beside(observer, samples))
                elapsed = _written(writer.write, frames(observations, additional_data=additional_data))
                last = deque(enumerate(progress(elapsed) if progress else elapsed, 1), maxlen=1)
                if samples is not None:
                    samples.finish()
            writer.close()
        except Exception as error:
            raise finish_partial(writer, Path(destination), error, force=force) from None
        except BaseException:
            writer.abort()
            raise
    count, seconds = last.pop() if last else (0, 0.0)
    counts, dropped = ({}, {}) if samples is None else (dict(samples.counts), dict(samples.dropped))
    return Captured(count, seconds, observer.missed, observer.why, counts, dropped, observer.is_cut_short)


def _beside(observer: Observer, samples: SampleRecorder | None) -> Iterator[Observation]:
    """Yield the observations, and write what sensors send beside them."""
    if samples is None:
        yield from observer.observations()
        return
    for observation in observer.observations(samples.advance):
        samples.advance(observation.frame)
        yield observation


def header_of(observer: Observer) -> Header:
    """Return the header of a recording that begins now."""
    return Header(observer.map.name.rpartition("/")[2], int(time.time()))


def frames(observations: Iterable[Observation], *, additional_data: bool) -> Iterator[Frame]:
    """Yield the frames of a recording of observations, each when its duration is known."""
    latest: Frame | None = None
    for frame in live_frames(observations, additional_data=additional_data):
        if latest is not None:
            latest.duration = frame.elapsed - latest.elapsed
            yield latest
        latest = frame
    if latest is not None:
        yield latest


def live_frames(observations: Iterable[Observation], *, additional_data: bool) -> Iterator[Frame]:
    """Yield the same frames at once, without their durations."""
    first: Observation | None = None
    for number, observation in enumerate(observations):
        first = first or observation
        clocks = {"visual_time": observation.time}
        if additional_data:
            clocks["platform_time"] = observation.real_time - first.real_time
        packets = packets_of(UE4, clocks | observation.records, additional_data=additional_data)
        yield Frame(number, number + 1, observation.time - first.time, LAST_FRAME_DURATION, [*packets, _END])


def until(duration: float, observer: Observer, observations: Iterable[Observation]) -> Iterator[Observation]:
    """Yield observations of an observer until a number of simulated seconds have passed, which ends it."""
    begin: float | None = None
    for observation in observations:
        yield observation
        begin = observation.time if begin is None else begin
        if observation.time - begin >= duration - _ROUNDING:
            observer.end(_DONE)
            return


def _written(write: Callable[[Frame], Any], frames: Iterable[Frame]) -> Iterator[float]:
    for frame in frames:
        write(frame)
        yield frame.elapsed
