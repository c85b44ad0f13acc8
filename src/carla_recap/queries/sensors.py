"""The sensors whose data a recording has beside its frames, in topics of their own."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final

from carla_recap.errors import RecapError
from carla_recap.tables import Rows
from carla_recap.util.text import first_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.formats.base import FurtherTopic, Reader, TopicMessage

ROOT: Final = "/sensors/"
"""What the names of all sensors' topics begin with; the sensor's id follows."""
SPEC: Final = "sensor"
"""The metadata of a sensor's topic: its specification, as JSON."""
PICTURES: Final = ("image", "video")
IMAGES: Final = (*PICTURES, "depth", "semantic", "instance", "normals", "flow")
"""The kinds of data that are images; `PICTURES` are in the colours that are seen."""
_DEEPEST: Final = 16  # levels of a specification; those of rigs have two


@dataclass(frozen=True, slots=True)
class RecordedSensor:
    """A sensor whose data a recording has.

    Attributes:
        id: Its id in its rig.
        type: Its type, such as `sensor.camera.rgb`.
        topics: The topics of its data.
        count: The number of messages on all of them.
        first: The elapsed time of the first message, in s; None where there is none.
        last: The elapsed time of the last message, in s; None where there is none.
        spec: Its specification, as its topics have it: id, type, pose in CARLA's axes in m and degrees, attributes.
    """

    id: str
    type: str
    topics: list[str]
    count: int
    first: float | None
    last: float | None
    spec: dict[str, Any] = field(repr=False)


class RecordedSensors(Rows[RecordedSensor]):
    """The sensors of a recording, in the order of its file."""

    row_type = RecordedSensor
    row_units: ClassVar = {"first": "s", "last": "s"}


def sensors(source: Reader) -> RecordedSensors:
    """Return the sensors of a recording: the topics `/sensors/ID/…` whose metadata have the specification of a sensor."""
    topics: dict[str, list[FurtherTopic]] = {}
    specs: dict[str, dict[str, Any]] = {}
    for name, topic in source.further_topics().items():
        id = name.removeprefix(ROOT).partition("/")[0]
        spec = _spec(topic.topic.metadata.get(SPEC, "")) if name.startswith(f"{ROOT}{id}/") and id else None
        if spec is not None:
            topics.setdefault(id, []).append(topic)
            specs.setdefault(id, spec)
    return RecordedSensors(_sensor(id, specs[id], found) for id, found in topics.items())


def sensor_messages(source: Reader, id: str, start: float, stop: float) -> Iterator[TopicMessage]:
    """Yield the messages of a sensor in order of time; see `Recording.sensor_messages`."""
    found = sensors(source)
    for sensor in found:
        if sensor.id == id:
            return source.further_messages(sensor.topics, start, stop)
    has = first_of([sensor.id for sensor in found])
    raise RecapError(f"{source.location}: has no data of a sensor {id!r:.200}; it has those of {has:.500}")


def kind_of(topic: str) -> str:
    """Return what the messages of a sensor's topic are: the last part of its name."""
    return topic.rpartition("/")[2]


def has_images(sensor: RecordedSensor) -> bool:
    """Return whether a recording has the RGB images of a sensor, as JPEGs or as a video."""
    return any(kind_of(topic) in PICTURES for topic in sensor.topics)


def check_new(source: Reader, ids: Iterable[str]) -> None:
    """Check that a recording has no data of sensors."""
    known = {sensor.id for sensor in sensors(source)}
    for id in ids:
        if id in known:
            raise RecapError(f"{source.location}: has data of a sensor {id!r} already")


def _sensor(id: str, spec: dict[str, Any], topics: list[FurtherTopic]) -> RecordedSensor:
    names, count = [topic.topic.name for topic in topics], sum(topic.count for topic in topics)
    first = min((topic.first for topic in topics if topic.first is not None), default=None)
    last = max((topic.last for topic in topics if topic.last is not None), default=None)
    return RecordedSensor(id, spec["type"], names, count, first, last, spec)


def _spec(text: str) -> dict[str, Any] | None:
    """Return the specification of a sensor; None for what is none."""
    try:
        spec = json.loads(text)
        is_spec = isinstance(spec, dict) and isinstance(spec.get("type"), str) and _depth(spec) <= _DEEPEST
    except (ValueError, RecursionError):
        return None
    return spec if is_spec else None


def _depth(value: Any) -> int:
    """Return how many levels of objects and lists there are, those of a number or a text included."""
    items = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + max(map(_depth, items), default=0)
