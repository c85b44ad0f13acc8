"""The options and arguments of commands: how they are said, the types of their values, and those that several share."""

from __future__ import annotations

import inspect
import math
import re
from contextlib import suppress
from functools import partial, wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

import click

from carla_recap.cli.opening import AROUND
from carla_recap.cli.output import ask_json
from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from datetime import datetime

    from click.core import ParameterSource

    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.sensors.rig import SensorRig

    Command = Callable[..., Any]

# --- how options are said ----------------------------------------------------------------------------------------------


def option(*names: str, **how: Any) -> Any:
    """Return an option, as a decorator or as the default of a parameter of a `command`; help shows what it is by default."""
    if how.get("default") is not None:
        how.setdefault("show_default", True)
    return click.option(*names, **how)


def flag(*names: str, help: str) -> Any:
    """Return an option without a value."""
    return click.option(*names, is_flag=True, help=help)


def path(*names: str, metavar: str = "FILE", **how: Any) -> Any:
    """Return an option for a path."""
    return option(*names, type=click.Path(), metavar=metavar, **how)


def argument(name: str, metavar: str, **how: Any) -> Any:
    """Return an argument, which is a path unless it has another type."""
    return click.argument(name, metavar=metavar, **{"type": click.Path(), **how})


def together(*decorators: Callable[[Command], Command]) -> Any:
    """Return several options as one decorator, in the order in which help lists them."""

    def decorate(command: Command) -> Command:
        for decorator in reversed(decorators):
            command = decorator(command)
        return command

    return decorate


def described_by(description: Callable[..., Any]) -> Any:
    """Return the options that are the defaults of the parameters of a function, or of the fields of a dataclass."""
    defaults = [each.default for each in inspect.signature(description).parameters.values()]
    return together(*(each for each in defaults if each is not inspect.Parameter.empty))


def command(*more: Callable[[Command], Command], **how: Any) -> Callable[[Command], click.Command]:
    """Return a decorator that makes a command of a function.

    Its options are the defaults of parameters of the function, and `more` behind them.
    """

    def decorate(function: Command) -> click.Command:
        made: click.Command = click.command(**how)(together(described_by(function), *more)(function))
        return made

    return decorate


def merged(name: str | None, load: Callable[[], Callable[..., Any]], *options: Callable[[Command], Command]) -> Any:
    """Return options as one decorator; a command gets what a function, or a dataclass, makes of those that it takes.

    Without a name, the command does not get it. `load` returns the function when the command runs, so that the help does not
    import it; its parameters may also be options that stand before this one.
    """

    def decorate(command: Command) -> Command:
        @wraps(command)
        def with_one(**given: Any) -> Any:
            merge = load()
            value = merge(**{each: given.pop(each) for each in inspect.signature(merge).parameters if each in given})
            return command(**given) if name is None else command(**{name: value}, **given)

        decorated: Command = together(*options)(with_one)
        return decorated

    return decorate


# --- the types of their values -----------------------------------------------------------------------------------------


class _Number(click.ParamType[Any]):
    """A number."""

    name = "number"

    def __init__(self, least: float = -math.inf, most: float = math.inf, *, exclusive: bool = False) -> None:
        self._least = least
        self._most = most
        self._exclusive = exclusive

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not self._least <= number <= self._most or (self._exclusive and number == self._least):
            self.fail(f"{value!r} is not a number{self._range()}.", param, ctx)
        return number

    def _range(self) -> str:
        if self._least == -math.inf:
            return ""
        if self._exclusive:
            return f" of more than {self._least:g}"
        return f" of {self._least:g} or more" if self._most == math.inf else f" of {self._least:g} to {self._most:g}"


class Parsed(click.ParamType[Any]):
    """What a function makes of a text; its `ValueError` or `RecapError` says what is wrong with it."""

    def __init__(self, name: str, parse: Callable[[str], Any]) -> None:
        self.name = name
        self._parse = parse

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See `click.ParamType.convert`."""
        if not isinstance(value, str):
            return value
        try:
            return self._parse(value)
        except (RecapError, ValueError) as error:
            self.fail(f"{error}.", param, ctx)


def _actor_id(words: tuple[str, ...], expected: str, text: str) -> int | str:
    """Return the id of an actor, or one of some words."""
    if text in words:
        return text
    if not re.fullmatch("[0-9]{1,20}", text):
        raise ValueError(f"{text!r} is neither {expected}")
    return int(text)


def _kinds(text: str) -> frozenset[str]:
    """Return kinds of incidents, which have commas between them."""
    from carla_recap.queries.kinds import kinds_named

    try:
        return kinds_named(text.split(","))
    except RecapError as error:
        raise ValueError(f"{error}, and all") from None


def _date(text: str) -> datetime:
    """Return a date and time, as of ISO 8601 or as `info` prints them; of this time zone unless it says another."""
    from datetime import datetime

    for parse in (datetime.fromisoformat, lambda text: datetime.strptime(text, "%m/%d/%y %H:%M:%S")):
        with suppress(ValueError, OverflowError):  # which a date is that is of the year 0 or 10000 in this time zone
            return parse(text).astimezone()
    raise ValueError(f"{text!r} is no date; one such as 2024-05-01 or 2024-05-01T12:30:00Z was expected")


def _size(text: str) -> tuple[int, int]:
    """Return a width and a height in pixels."""
    match = re.fullmatch("([0-9]{1,5})[xX]([0-9]{1,5})", text)
    if match is None:
        raise ValueError(f"{text!r} is no size; WIDTHxHEIGHT was expected, such as 1280x720")
    return int(match[1]), int(match[2])


def _split(text: str) -> dict[str, float]:
    """Return the shares of splits by name."""
    from carla_recap.fleet.datasets import splits_of

    pairs = [part.partition("=") for part in text.split(",")]
    try:
        shares = {name.strip(): float(share) for name, _, share in pairs}
    except ValueError:
        raise ValueError(f"{text!r} are no shares; some such as train=0.8,val=0.2 were expected") from None
    splits_of((), shares)
    return shares


NUMBER = _Number(0)
POSITIVE = _Number(0, exclusive=True)
TIME = _Number()
PERCENT = _Number(0, 100)
FOLLOW = Parsed("actor", partial(_actor_id, ("hero",), "an actor id nor hero"))
MEASURED = Parsed("actor", partial(_actor_id, ("hero", "all"), "an actor id nor hero or all"))
VIEW = Parsed("view", partial(_actor_id, ("chase", "top", "driver"), "chase, top or driver nor the id of a recorded camera"))
KINDS = Parsed("kinds", _kinds)
DATE = Parsed("date", _date)
SIZE = Parsed("size", _size)
PORT = click.IntRange(0, 65535)
JOBS = click.IntRange(1, 10_000)


# --- the form of an answer ---------------------------------------------------------------------------------------------


class _FormOption(click.Option):
    """An option for the form of an answer; two of them contradict each other."""

    def add_to_parser(self, parser: Any, ctx: click.Context) -> None:
        parser.add_option(obj=self, opts=self.opts, dest=self.name, action="append_const", const=self.flag_value)

    def consume_value(self, ctx: click.Context, opts: Mapping[str, Any]) -> tuple[Any, ParameterSource]:
        value, source = super().consume_value(ctx, opts)
        if not isinstance(value, list):
            return value, source
        if len(forms := dict.fromkeys(value)) > 1:
            raise click.UsageError(f"{' and '.join(f'--{form}' for form in forms)}: one of them was expected.")
        return value[0], source


def form(name: str, help: str) -> Any:
    """Return the option for a form of the answer, such as json."""
    return click.option(f"--{name}", "form", cls=_FormOption, flag_value=name, help=help)


json = form("json", "Print JSON.")
csv = form("csv", "Print CSV.")
text = form("text", "Print CARLA's text, as in a pipe.")
json_or_text = together(json, form("text", "Print text, as in a pipe."))
compat = flag("--compat", help="Answer and print as CARLA 0.9.16 does, its errors included; implies --text.")
max_rows = option("--max-rows", type=click.IntRange(min=0), metavar="N", help="End with exit code 1 if there are more rows.")
written = click.option("--json", is_flag=True, expose_value=False, callback=ask_json, help="Print what was written as JSON.")


# --- which recordings, which part of them, and where to ----------------------------------------------------------------

EPILOG = "Each SOURCE is a recording, a folder, a glob in quotes, or a URL; - is a list of them on stdin, one in a line."

sources = argument("sources", "SOURCE...", type=click.Path(allow_dash=True), nargs=-1, required=True)
source = argument("source", "SRC")
destination = argument("destination", "DST")
jobs = option("--jobs", type=JOBS, metavar="N", help="The number of processes that read many recordings.")
dask = option("--dask", metavar="ADDRESS", help="Read many recordings on the Dask cluster with this scheduler.")
additional_data = flag("--additional-data", help="Record velocities, boxes, physics and times, too.")
force = flag("--force", help="Overwrite what exists.")
start = option("--start", type=TIME, metavar="S", help="The time to begin at, in s; negative: before the end.")
duration = option("--duration", type=NUMBER, metavar="S", help="The number of seconds; 0: all of the rest.")
road_map = path(
    *("--map", "road_map"),
    help="The town's map, an OpenDRIVE .xodr or a folder of them; else looked for in $CARLA_RECAP_MAPS.",
)


def format_of_files(formats: Sequence[str]) -> Any:
    """Return the option for the format of files in a folder, of which the first is the usual one."""
    words = f"The format of files in a folder, by default {formats[0]}; a single file has the one of its suffix."
    return option("--to", "--format", "suffix", type=click.Choice(formats), help=words)


# --- incidents ---------------------------------------------------------------------------------------------------------


class _KindsOption(click.Option):
    """The option for kinds of incidents; the table of kinds, which its help names, is imported if that is asked for."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        from carla_recap.queries.kinds import KINDS

        kinds = list(KINDS.values())
        usual = ", ".join(kind.option for kind in kinds if not kind.every_frame)
        others = ", ".join(kind.option for kind in kinds if kind.every_frame and not kind.needs_roads)
        of_road = ", ".join(kind.option for kind in kinds if kind.needs_roads)
        every = ", ".join(kind.option for kind in kinds)
        self.help = str(self.help).format(usual=usual, others=others, of_road=of_road, every=every)
        return super().get_help_record(ctx)


def _kinds_option(help: str, *, otherwise: Literal["all"] | None) -> Any:
    """Return the option for kinds of incidents, which may be repeated."""

    def together(_: click.Context, __: click.Parameter, given: tuple[frozenset[str], ...]) -> frozenset[str] | str | None:
        return frozenset[str]().union(*given) or otherwise

    how: dict[str, Any] = {"type": KINDS, "multiple": True, "metavar": "all|KIND,...", "callback": together}
    return option("--kinds", cls=_KindsOption, help=help, **how)


kinds = _kinds_option(
    "The kinds of incidents: {usual} (these if none are given), {others}, with a map {of_road}; or all.", otherwise=None
)
shown_kinds = _kinds_option("The kinds of incidents to show: {every}; by default all.", otherwise="all")
before = option("--before", type=NUMBER, default=AROUND, metavar="S", help="Seconds before an incident.")
after = option("--after", type=NUMBER, default=AROUND, metavar="S", help="Seconds after it.")
min_distance = option("--min-distance", type=NUMBER, default=10, metavar="CM", help="Least movement, in cm.")


def min_time(type: click.ParamType[Any] = NUMBER) -> Any:
    """Return the option for the shortest stop."""
    return option("--min-time", type=type, default=30, metavar="S", help="Shortest stop to report, in s.")


incident_options = together(
    road_map,
    option("--actor", type=FOLLOW, metavar="ID|hero", help="The actor that has to take part in the incidents; else any."),
    min_time(),
    min_distance,
    option("--deceleration", type=POSITIVE, default=6, metavar="M/S²", help="Least deceleration of hard braking."),
    *(
        option(
            f"--{name}", type=click.FloatRange(0, 60), default=default, metavar="S", help=f"Greatest {what} of a near miss."
        )
        for name, what, default in (
            ("time-to-collision", "time to collision", 1.5),
            ("post-encroachment-time", "post-encroachment time", 1),
        )
    ),
    option(
        "--required-deceleration",
        type=NUMBER,
        default=0,
        metavar="M/S²",
        help="Least deceleration that a near miss by its time to collision requires.",
    ),
    merged("wanted", lambda: import_module("carla_recap.queries.incidents").IncidentOptions),
)
"""The options that say which incidents to find, as an `IncidentOptions`."""


def shown_incidents(kinds: frozenset[str] | Literal["all"], road_map: str | None = None) -> IncidentOptions | None:
    """Return which incidents are shown; None: all kinds that can be found with the usual maps."""
    from carla_recap.queries.incidents import IncidentOptions

    return None if kinds == "all" and road_map is None else IncidentOptions(kinds=kinds, road_map=road_map)


# --- pictures, sensors and viewers -------------------------------------------------------------------------------------

follow = option(
    "--follow",
    type=FOLLOW,
    metavar="ID|hero",
    help="The actor that the camera follows; else the hero, the first to collide, or the one that goes farthest.",
)
camera = option("--view", type=click.Choice(["chase", "top"]), default="chase", help="The camera.")
any_view = option(
    "--view",
    type=VIEW,
    default="chase",
    metavar="chase|top|driver|ID",
    help="From behind, from above, the driver's, or that of a recorded camera.",
)
overlay = option(
    "--overlay/--no-overlay",
    default=None,
    help="Show time, speed, controls, lights and incidents on it; by default it does, unless the view is a recorded camera.",
)


def _use_models(models: str | None) -> None:
    if models is not None:
        from carla_recap.scene.models import use_models

        use_models(models)


models = merged(
    None, lambda: _use_models, path("--models", metavar="DIR", help="Your own models, such as vehicle.tesla.model3.glb.")
)
"""The option for models of one's own, which are in use while a command runs that does not take them."""


def _load_rig(rig: str | None, leaderboard: bool) -> SensorRig | None:
    from carla_recap.sensors.rig import SensorRig

    if rig is None and leaderboard:
        raise click.UsageError("--leaderboard goes with --rig.")
    return None if rig is None else SensorRig.load(rig, leaderboard=leaderboard)


def rig(text: str, *, is_required: bool = False) -> Any:
    """Return the options for a rig, which a command takes as a `SensorRig`, or None."""
    file = path("--rig", required=is_required, help=text)
    as_leaderboard = flag("--leaderboard", help="Give its sensors the values that the CARLA Leaderboard fixes.")
    return merged("rig", lambda: _load_rig, file, as_leaderboard)


carrier = option("--actor", type=FOLLOW, default="hero", metavar="ID|hero", help="The actor that carries the rig.")
sensing = together(
    carrier,
    option(
        "--rate", type=POSITIVE, metavar="HZ", help="Moments per second; else each frame, of datasets 10, of nuscenes 2."
    ),
    option(
        "--quality",
        type=click.Choice(["low", "epic"]),
        default="epic",
        help="Of RGB images; low ones have neither shadows nor smooth edges, and take less time.",
    ),
)
"""The fields of `SensingOptions` that are not those of other exports, too."""
dataset = together(
    option("--camera", metavar="ID", help="The camera of KITTI; else the first one of the rig."),
    option(
        "--split",
        type=Parsed("split", _split),
        metavar="NAME=SHARE,...",
        help="Such as train=0.8,val=0.2; else all are in train.",
    ),
)

RELEASES = ("auto", "0.9.13", "0.9.14", "0.9.15", "0.9.16", "0.10.0")
carla = option(
    "--carla",
    type=click.Choice(RELEASES),
    default="auto",
    help="The release of clients, others of which are refused; auto: each one's own, found on this machine, else 0.9.16.",
)


def _foxglove_port(foxglove: bool, foxglove_port: int | None) -> int | None:
    if foxglove_port is None and foxglove:
        from carla_recap.show.foxglove.websocket import PORT

        return PORT
    return foxglove_port


foxglove = merged(
    "foxglove_port",
    lambda: _foxglove_port,
    flag("--foxglove", help="Let Foxglove connect to a WebSocket instead of opening Rerun's viewer."),
    option("--foxglove-port", type=PORT, metavar="N", help="The port of that WebSocket, 0 for any free one; else 8765."),
)
"""The options for Foxglove; a command takes the port to which it is to connect, or None."""
