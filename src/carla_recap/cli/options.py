"""Arguments and options that several commands share."""

from __future__ import annotations

from dataclasses import fields
from functools import wraps
from typing import TYPE_CHECKING, Any, Literal

import click

from carla_recap.cli.opening import AROUND
from carla_recap.cli.output import ask_json
from carla_recap.cli.parameter_types import FOLLOW, KINDS, NUMBER, POSITIVE, SPLIT, TIME, VIEW

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from click.core import ParameterSource

    from carla_recap.queries.incidents import IncidentOptions

    Command = Callable[..., Any]


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


def _ask_json(_: click.Context, __: click.Parameter, value: bool) -> None:
    if value:
        ask_json()


sources = click.argument("sources", type=click.Path(allow_dash=True), metavar="SOURCE...", nargs=-1, required=True)
jobs = click.option(
    "--jobs", type=click.IntRange(1, 10_000), metavar="N", help="The number of processes that read many recordings."
)
dask = click.option("--dask", metavar="ADDRESS", help="Read many recordings on the Dask cluster with this scheduler.")
source = click.argument("source", type=click.Path(), metavar="SRC")
destination = click.argument("destination", type=click.Path(), metavar="DST")
folder = click.argument("folder", type=click.Path(), metavar="DIR")
additional_data = click.option("--additional-data", is_flag=True, help="Record velocities, boxes, physics and times, too.")
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
    default=None,
    help="Show time, speed, controls, lights and incidents on it; by default it does, unless the view is a recorded camera.",
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
required_deceleration = click.option(
    "--required-deceleration",
    type=NUMBER,
    default=0,
    show_default=True,
    metavar="M/S²",
    help="Least deceleration that a near miss by its time to collision requires.",
)
involved = click.option(
    "--actor", type=FOLLOW, metavar="ID|hero", help="The actor that has to take part in the incidents; else any."
)


def gathered(name: str, load: Callable[[], type[Any]]) -> Callable[[Command], Command]:
    """Return a decorator that passes the parameters of a command that are fields of a dataclass as an instance of it.

    `load` returns the dataclass when the command runs, so that the help does not import it.
    """

    def decorate(command: Command) -> Command:
        @wraps(command)
        def with_one(*arguments: Any, **given: Any) -> Any:
            kind = load()
            own = {field.name: given.pop(field.name) for field in fields(kind) if field.name in given}
            return command(*arguments, **{name: kind(**own)}, **given)

        return with_one

    return decorate


def _load_incident_options() -> type[IncidentOptions]:
    from carla_recap.queries.incidents import IncidentOptions

    return IncidentOptions


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


incident_options = together(
    road_map,
    involved,
    min_time,
    min_distance,
    deceleration,
    time_to_collision,
    post_encroachment_time,
    required_deceleration,
    gathered("wanted", _load_incident_options),
)
"""The options that say which incidents to find, as an `IncidentOptions`."""


def rig(text: str, *, is_required: bool = False) -> Callable[[Command], Command]:
    """Return a decorator that adds the options for a rig to a command, which takes it as a `SensorRig`, or None."""

    def decorate(command: Command) -> Command:
        @click.option("--rig", type=click.Path(), required=is_required, metavar="FILE", help=text)
        @click.option("--leaderboard", is_flag=True, help="Give its sensors the values that the CARLA Leaderboard fixes.")
        @wraps(command)
        def with_rig(*arguments: Any, rig: str | None, leaderboard: bool, **given: Any) -> None:
            from carla_recap.sensors.rig import SensorRig

            if rig is None and leaderboard:
                raise click.UsageError("--leaderboard goes with --rig.")
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
        type=SPLIT,
        metavar="NAME=SHARE,...",
        help="Such as train=0.8,val=0.2; else all are in train.",
    ),
)

RELEASES = ("auto", "0.9.13", "0.9.14", "0.9.15", "0.9.16", "0.10.0")
carla = click.option(
    "--carla",
    type=click.Choice(RELEASES),
    default="auto",
    show_default=True,
    help="The release of clients, others of which are refused; auto: each one's own, found on this machine, else 0.9.16.",
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
