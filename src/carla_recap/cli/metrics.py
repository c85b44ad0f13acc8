"""The command that runs ScenarioRunner's metrics."""

from __future__ import annotations

import traceback
from pathlib import Path

import click

from carla_recap.cli import options
from carla_recap.cli.output import UNMET, warn


@click.command()
@click.option("--metric", required=True, type=click.Path(), metavar="FILE", help="The metric, a .py file.")
@click.option("--log", "source", required=True, type=click.Path(), metavar="FILE", help="The recording.")
@click.option("--criteria", type=click.Path(), metavar="FILE", help="A JSON file of criteria, as ScenarioRunner writes it.")
@options.road_map
@click.pass_context
def metrics(ctx: click.Context, metric: str, source: str, criteria: str | None, road_map: str | None) -> None:
    """Run a metric that was written for ScenarioRunner, without a server.

    The file of the metric runs as it is, whether or not ScenarioRunner is installed. If it raises an error, the exit code
    is 1.
    """
    from carla_recap.errors import RecapError
    from carla_recap.metrics import MetricsLog, run_metric
    from carla_recap.queries.roads import find_map_of
    from carla_recap.recording import open_recording

    with open_recording(source) as recording:
        opendrive = find_map_of(recording.reader, road_map)
        if opendrive is None:
            warn(f"no map for {recording.header.map_name!r}: the metric's town_map is None; --map names the file")
        try:
            run_metric(metric, MetricsLog(recording), opendrive=opendrive, criteria=criteria)
        except RecapError:
            raise
        except Exception as error:
            trace = error.__traceback__
            while trace is not None and Path(trace.tb_frame.f_code.co_filename).name != Path(metric).name:
                trace = trace.tb_next
            traceback.print_exception(type(error), error, trace)
            ctx.exit(UNMET)
