"""Arguments and options that several commands share, and the recordings and maps that they name."""

from __future__ import annotations

import math
import re
from contextlib import closing, suppress
from functools import wraps
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar

import click

from carla_recap.cli.output import ask_json

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from click.core import ParameterSource

    from carla_recap.formats.base import Reader
    from carla_recap.formats.sources import TimeFragment
    from carla_recap.model.lives import ActorName
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.recording import Recording
    from carla_recap.rendering.town import TownMesh
    from carla_recap.roads import RoadMap

    Command = Callable[..., Any]

T = TypeVar("T")

MOMENT: Final = 1e-3
"""The seconds of a recording that a picture shows."""

AROUND: Final = 5.0
"""The seconds before and after an incident, or a moment, that are shown."""

_PRINTED: Final = 0.06  # s by which a printed time may be after the end
_AROUND: Final = 30.0  # s around what is shown, in which vehicles drive along what are its roads


class _Number(click.ParamType[Any]):
    """A number.

    Args:
        least: The smallest valid number.
        exclusive: Whether that one is not valid either.
    """

    name = "number"

    def __init__(self, least: float = -math.inf, *, exclusive: bool = False) -> None:
        self._least = least
        self._exclusive = exclusive

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not number >= self._least or (self._exclusive and number == self._least):
            least = f" of more than {self._least:g}" if self._exclusive else f" of {self._least:g} or more"
            self.fail(f"{value!r} is not a number{'' if self._least == -math.inf else least}.", param, ctx)
        return number


class _Follow(click.ParamType[Any]):
    """An actor id, or hero."""

    name = "actor"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "hero" or isinstance(value, int):
            return value
        if not (value.isascii() and value.isdecimal()):
            self.fail(f"{value!r} is neither an actor id nor hero.", param, ctx)
        return int(value)


class _Measured(click.ParamType[Any]):
    """An actor id, hero or all."""

    name = "actor"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in ("hero", "all") or isinstance(value, int):
            return value
        if not (value.isascii() and value.isdecimal()):
            self.fail(f"{value!r} is neither an actor id nor hero or all.", param, ctx)
        return int(value)


class _Kinds(click.ParamType[Any]):
    """Kinds of incidents, with commas between them, or all."""

    name = "kinds"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from carla_recap.errors import RecapError
        from carla_recap.queries.kinds import kinds_named

        if not isinstance(value, str):
            return value
        try:
            return kinds_named(value.split(","))
        except RecapError as error:
            self.fail(f"{error}, and all.", param, ctx)


class _FormOption(click.Option):
    """An option for the form of an answer; two of them contradict each other."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        parser.add_option(obj=self, opts=self.opts, dest=self.name, action="append_const", const=self.flag_value)

    def consume_value(self, ctx: click.Context, opts: Mapping[str, Any]) -> tuple[Any, ParameterSource]:
        value, source = super().consume_value(ctx, opts)
        if not isinstance(value, list):
            return value, source
        if len(forms := dict.fromkeys(value)) > 1:
            raise click.UsageError(f"{' and '.join(f'--{form}' for form in forms)}: one of them was expected.", ctx)
        return value[0], source


def form(name: str, help: str) -> Callable[[Command], Command]:
    """Return the option for a form of the answer, such as json."""
    return click.option(f"--{name}", "form", cls=_FormOption, flag_value=name, help=help)


class _KindsOption(click.Option):
    """The option for kinds of incidents, which may be repeated; the table of kinds is imported if its help is asked for."""

    def process_value(self, ctx: click.Context, value: Any) -> frozenset[str] | None:
        given: tuple[frozenset[str], ...] = super().process_value(ctx, value)
        return frozenset[str]().union(*given) or None

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        from carla_recap.queries.kinds import KINDS

        kinds = KINDS.values()
        usual = ", ".join(kind.option for kind in kinds if not kind.every_frame)
        others = ", ".join(kind.option for kind in kinds if kind.every_frame and not kind.needs_roads)
        of_road = ", ".join(kind.option for kind in kinds if kind.needs_roads)
        self.help = f"The kinds of incidents: {usual} (these if none are given), {others}, with a map {of_road}; or all."
        return super().get_help_record(ctx)


class _ShownKindsOption(_KindsOption):
    """The option for kinds of incidents where all are shown if none are given."""

    def process_value(self, ctx: click.Context, value: Any) -> Any:
        return super().process_value(ctx, value) or "all"

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        from carla_recap.queries.kinds import KINDS

        self.help = f"The kinds of incidents to show: {', '.join(kind.option for kind in KINDS.values())}; by default all."
        return click.Option.get_help_record(self, ctx)


class _Date(click.ParamType[Any]):
    """A date and time, as of ISO 8601 or as `info` prints them; of this time zone unless it says another."""

    name = "date"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from datetime import datetime

        for parse in (datetime.fromisoformat, lambda text: datetime.strptime(text, "%m/%d/%y %H:%M:%S")):
            with suppress(ValueError):
                return parse(value).astimezone()
        return self.fail(f"{value!r} is no date; one such as 2024-05-01 or 2024-05-01T12:30:00Z was expected.", param, ctx)


class _View(click.ParamType[Any]):
    """A view of the software renderer: its name, or the id of a recorded camera."""

    name = "view"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in ("chase", "top", "driver") or isinstance(value, int):
            return value
        if not (value.isascii() and value.isdecimal()):
            self.fail(f"{value!r} is neither chase, top or driver nor the id of a recorded camera.", param, ctx)
        return int(value)


class _Size(click.ParamType[Any]):
    """A width and a height in pixels."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        match = re.fullmatch("([0-9]{1,5})[xX]([0-9]{1,5})", value)
        if match is None:
            self.fail(f"{value!r} is no size; WIDTHxHEIGHT was expected, such as 1280x720.", param, ctx)
        return int(match[1]), int(match[2])


class _Split(click.ParamType[Any]):
    """Names of splits with their shares."""

    name = "split"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from carla_recap.errors import RecapError
        from carla_recap.fleet.datasets import splits_of

        if not isinstance(value, str):
            return value
        pairs = [part.partition("=") for part in value.split(",")]
        try:
            shares = {name.strip(): float(share) for name, _, share in pairs}
        except ValueError:
            self.fail(f"{value!r} are no shares; some such as train=0.8,val=0.2 were expected.", param, ctx)
        try:
            splits_of((), shares)
        except RecapError as error:
            self.fail(f"{error}.", param, ctx)
        return shares


def _ask_json(context: click.Context, _: click.Parameter, value: bool) -> None:
    if value:
        ask_json(context)


NUMBER = _Number(0)
POSITIVE = _Number(0, exclusive=True)
TIME = _Number()
FOLLOW = _Follow()
MEASURED = _Measured()
KINDS = _Kinds()
DATE = _Date()
SIZE = _Size()
VIEW = _View()

recording = click.argument("file", type=click.Path(), metavar="FILE")
sources = click.argument("sources", type=click.Path(allow_dash=True), metavar="SOURCE...", nargs=-1, required=True)
jobs = click.option(
    "--jobs", type=click.IntRange(1, 10_000), metavar="N", help="The number of processes that read many recordings."
)
dask = click.option("--dask", metavar="ADDRESS", help="Read many recordings on the Dask cluster with this scheduler.")
source = click.argument("source", type=click.Path(), metavar="SRC")
destination = click.argument("destination", type=click.Path(), metavar="DST")
folder = click.argument("folder", type=click.Path(), metavar="DIR")
force = click.option("--force", is_flag=True, help="Overwrite what exists.")
json = form("json", "Print JSON.")
csv = form("csv", "Print CSV.")
written = click.option(
    "--json",
    is_flag=True,
    expose_value=False,
    callback=_ask_json,
    help="Print what was written as JSON.",
)
text = form("text", "Print CARLA's text, as in a pipe.")
plain = form("text", "Print text, as in a pipe.")
compat = click.option(
    "--compat",
    is_flag=True,
    help="Answer and print as CARLA 0.9.16 does, its errors included; implies --text.",
)
max_rows = click.option(
    "--max-rows", type=click.IntRange(min=0), metavar="N", help="End with exit code 1 if there are more rows."
)
min_time = click.option(
    "--min-time", type=NUMBER, default=30, show_default=True, metavar="S", help="Shortest stop to report, in s."
)
min_distance = click.option(
    "--min-distance",
    type=NUMBER,
    default=10,
    show_default=True,
    metavar="CM",
    help="Least movement, in cm.",
)
start = click.option("--start", type=TIME, metavar="S", help="The time to begin at, in s; negative: before the end.")
duration = click.option("--duration", type=NUMBER, metavar="S", help="The number of seconds; 0: all of the rest.")
follow = click.option(
    "--follow",
    type=FOLLOW,
    metavar="ID|hero",
    help="The actor that the camera follows; else the hero, the first to collide, or the one that goes farthest.",
)
camera = click.option("--view", type=click.Choice(["chase", "top"]), default="chase", show_default=True, help="The camera.")
any_view = click.option(
    "--view",
    type=VIEW,
    default="chase",
    show_default=True,
    metavar="chase|top|driver|ID",
    help="From behind, from above, the driver's, or that of a recorded camera.",
)
overlay = click.option(
    "--overlay/--no-overlay",
    default=True,
    help="Show time, speed, controls, lights and incidents on it; by default it does.",
)
road_map = click.option(
    "--map",
    "road_map",
    type=click.Path(),
    metavar="FILE",
    help="The town's map, an OpenDRIVE .xodr or a folder of them; else looked for in $CARLA_RECAP_MAPS.",
)
before = click.option(
    "--before", type=NUMBER, default=AROUND, show_default=True, metavar="S", help="Seconds before an incident."
)
after = click.option("--after", type=NUMBER, default=AROUND, show_default=True, metavar="S", help="Seconds after it.")
kinds = click.option(
    "--kinds",
    cls=_KindsOption,
    type=KINDS,
    multiple=True,
    metavar="all|KIND,...",
)
shown_kinds = click.option(
    "--kinds",
    cls=_ShownKindsOption,
    type=KINDS,
    multiple=True,
    metavar="all|KIND,...",
)
deceleration = click.option(
    "--deceleration",
    type=POSITIVE,
    default=6,
    show_default=True,
    metavar="M/S²",
    help="Least deceleration of hard braking.",
)
time_to_collision = click.option(
    "--time-to-collision",
    type=click.FloatRange(0, 60),
    default=1.5,
    show_default=True,
    metavar="S",
    help="Greatest time to collision of a near miss.",
)
post_encroachment_time = click.option(
    "--post-encroachment-time",
    type=click.FloatRange(0, 60),
    default=1,
    show_default=True,
    metavar="S",
    help="Greatest post-encroachment time of a near miss.",
)
involved = click.option(
    "--actor", type=FOLLOW, metavar="ID|hero", help="The actor that has to take part in the incidents; else any."
)


def incident_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that say which incidents to find, for a command that takes them as an `IncidentOptions`."""

    @wraps(command)
    def decorated(
        *args: Any,
        road_map: str | None,
        min_time: float,
        min_distance: float,
        deceleration: float,
        time_to_collision: float,
        post_encroachment_time: float,
        actor: ActorName | None,
        kinds: frozenset[str] | Literal["all"] | None = "all",
        **given: Any,
    ) -> None:
        from carla_recap.queries.incidents import IncidentOptions

        wanted = IncidentOptions(
            kinds=kinds,
            road_map=road_map,
            min_time=min_time,
            min_distance=min_distance,
            deceleration=deceleration,
            time_to_collision=time_to_collision,
            post_encroachment_time=post_encroachment_time,
            actor=actor,
        )
        command(*args, wanted=wanted, **given)

    limits = (min_time, min_distance, deceleration, time_to_collision, post_encroachment_time)
    return together(road_map, involved, *limits)(decorated)


def shown_incidents(kinds: frozenset[str] | Literal["all"], road_map: str | None = None) -> IncidentOptions | None:
    """Return which incidents are shown; None: all kinds that can be found with the usual maps."""
    from carla_recap.queries.incidents import IncidentOptions

    return None if kinds == "all" and road_map is None else IncidentOptions(kinds=kinds, road_map=road_map)


def models(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the option for models of one's own, which are in use while it runs."""

    @click.option("--models", type=click.Path(), metavar="DIR", help="Your own models, such as vehicle.tesla.model3.glb.")
    @wraps(command)
    def with_models(*arguments: Any, models: str | None, **given: Any) -> None:
        if models is not None:
            from carla_recap.scene.models import use_models

            use_models(models)
        command(*arguments, **given)

    return with_models


def together(*decorators: Callable[[Command], Command]) -> Callable[[Command], Command]:
    """Return several options as one decorator, in the order in which help lists them."""

    def decorate(command: Command) -> Command:
        for decorator in reversed(decorators):
            command = decorator(command)
        return command

    return decorate


def rig(text: str, *, is_required: bool = False) -> Callable[[Command], Command]:
    """Return what gives a command the options for a rig, which it takes as a `SensorRig`, or as None.

    Args:
        text: The help of `--rig`.
        is_required: Whether it must be given.
    """

    def decorate(command: Command) -> Command:
        @click.option("--rig", type=click.Path(), required=is_required, metavar="FILE", help=text)
        @click.option("--leaderboard", is_flag=True, help="Give its sensors the values that the CARLA Leaderboard fixes.")
        @wraps(command)
        def with_rig(*arguments: Any, rig: str | None, leaderboard: bool, **given: Any) -> None:
            from carla_recap.sensors.rig import SensorRig

            if rig is None and leaderboard:
                raise click.UsageError("--leaderboard goes with --rig.", click.get_current_context())
            loaded = None if rig is None else SensorRig.load(rig, leaderboard=leaderboard)
            command(*arguments, rig=loaded, **given)

        return with_rig

    return decorate


carrier = click.option(
    "--actor",
    type=FOLLOW,
    default="hero",
    show_default=True,
    metavar="ID|hero",
    help="The actor that carries the rig.",
)
sensing = together(
    carrier,
    click.option(
        "--rate", type=POSITIVE, metavar="HZ", help="Moments per second; else each frame, of datasets 10, of nuscenes 2."
    ),
    click.option(
        "--quality",
        type=click.Choice(["low", "epic"]),
        default="epic",
        show_default=True,
        help="Of RGB images; low ones have neither shadows nor smooth edges, and take less time.",
    ),
)
"""The fields of `SensingOptions` that are not those of other exports, too."""
dataset = together(
    click.option("--camera", metavar="ID", help="The camera of KITTI; else the first one of the rig."),
    click.option(
        "--split",
        type=_Split(),
        metavar="NAME=SHARE,...",
        help="Such as train=0.8,val=0.2; else all are in train.",
    ),
)

foxglove = together(
    click.option("--foxglove", is_flag=True, help="Let Foxglove connect to a WebSocket instead of opening Rerun's viewer."),
    click.option(
        "--foxglove-port",
        type=click.IntRange(0, 65535),
        metavar="N",
        help="The port of that WebSocket, 0 for any free one; else 8765.",
    ),
)


def foxglove_port_of(is_wanted: bool, port: int | None) -> int | None:
    """Return the port to which Foxglove is to connect; None if it is not wanted."""
    if port is None and is_wanted:
        from carla_recap.show.foxglove.websocket import PORT

        return PORT
    return port


def opened(path: str) -> Reader:
    """Open a recording, which is closed when the command ends."""
    from carla_recap.formats import open_reader

    reader = open_reader(path)
    click.get_current_context().call_on_close(reader.close)
    return reader


def timed(source: str, given: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return a source without the times at its end (`#t=12.1`), and options with the start and duration that are meant.

    A moment is shown with the seconds around it that clips of incidents have. What the options say prevails.

    Args:
        source: The source.
        given: The options of a command, of which `start` and `duration` are None if they are not given.
    """
    from carla_recap.errors import RecapError

    location, times = _split(source)
    start, duration = given["start"], given["duration"]
    if times is None or start is not None:
        return location, given | {"start": start or 0.0, "duration": duration or 0.0}
    begin, end = max(times.start - AROUND, 0.0), times.start + AROUND
    if times.stop is None:
        _check_moment(location, times.start)
    else:
        begin, end = times.start, times.stop
    if not begin < end:
        raise RecapError(f"{source}: an end after {begin:g} s was expected")
    return location, given | {"start": begin, "duration": end - begin if duration is None else duration}


def moment(source: str, time: float | None) -> tuple[str, float]:
    """Return a source without the time at its end (`#t=12.1`), and the time that is meant: that of the option, if any.

    Raises:
        click.MissingParameter: There is neither.
    """
    location, times = _split(source)
    if time is None and times is None:
        ctx = click.get_current_context()
        raise click.MissingParameter("SRC#t=S says it, too.", ctx=ctx, param_hint="'--at'", param_type="option")
    return location, times.start if time is None and times is not None else time or 0.0


def _split(source: str) -> tuple[str, TimeFragment | None]:
    """Return a source without the times at its end, and these, if it has any.

    Raises:
        RecapError: What it has is no time.
    """
    from carla_recap.errors import RecapError
    from carla_recap.formats.sources import split_time

    location, times = split_time(source)
    name, mark, text = source.rpartition("#t=")
    if times is None and name and mark and not _exists(source):
        raise RecapError(f"{source}: {text!r} is no time; seconds were expected, such as #t=12.1, or #t=12.1,20")
    return location, times


def _exists(source: str) -> bool:
    """Return whether there is a file of exactly this name."""
    from pathlib import Path

    try:
        return Path(source).exists()
    except (OSError, ValueError):  # such as a name that is too long
        return False


def _check_moment(location: str, time: float) -> None:
    """Refuse a time after the end of a recording of this machine; others are not read twice.

    Raises:
        RecapError: It is one, or the recording cannot be read.
    """
    from carla_recap.errors import RecapError
    from carla_recap.formats import open_reader
    from carla_recap.formats.sources import is_remote

    if is_remote(location):
        return
    with closing(open_reader(location)) as reader:
        end = reader.extent().duration
    if time > end + _PRINTED:
        raise RecapError(f"{location}: nothing at {time:g} s; the recording ends at {end:g} s")


def road_map_of(recording: Recording, path: str | None, start: float = 0.0, duration: float = 0.0) -> RoadMap | None:
    """Return the map of a recording's town; without one, what its vehicles have driven along.

    None if that is not known either, or if an extra is missing; a warning says so.

    Args:
        recording: The recording; its map name is looked for.
        path: The map, or the folder to look in; None: the usual folders.
        start: The elapsed seconds from which on the recording is shown; negative: before the end.
        duration: The seconds that are shown; 0: all of the rest.

    Raises:
        RecapError: The given folder has no such map, or the map is damaged.
    """
    from carla_recap.replay.recorded_map import load_map_of
    from carla_recap.roads import load_map

    return load_map_of(recording, path, load_map, lambda corridors: corridors, start, duration)


def town_of(recording: Recording, path: str | None, start: float = 0.0, duration: float = 0.0) -> TownMesh | None:
    """Return a recording's town as a mesh; see `road_map_of`."""
    from carla_recap.rendering.town import load_town_of

    return load_town_of(recording, path, start, duration)


def map_file_of(recording: Recording, path: str | None) -> Path | None:
    """Return the OpenDRIVE file of a recording's town; None if it is unknown; see `road_map_of`."""
    from carla_recap.replay.recorded_map import find_map_of

    return find_map_of(recording, path)
