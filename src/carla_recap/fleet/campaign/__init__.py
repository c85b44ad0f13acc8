"""Campaigns: many runs of a simulation with other seeds and parameters, each a recording; on this machine or a cluster."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from carla_recap.errors import RecapError
from carla_recap.fleet.campaign.plan import CampaignRun, check_keywords, check_name, planned
from carla_recap.fleet.campaign.runs import FinishedRun, RunReport, Simulation, made_with
from carla_recap.fleet.destinations import DestinationFolder
from carla_recap.fleet.engine import map_sources
from carla_recap.formats.sources import is_remote
from carla_recap.sim.settings import seeded_date
from carla_recap.util.files import made_folder, scratch_folder, writing
from carla_recap.util.functions import FileFunction, keywords_of
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping

    from distributed import Client

    from carla_recap.fleet.campaign.plan import Value
    from carla_recap.fleet.campaign.results import Scoring

__all__ = ["Campaign", "FinishedRun", "RunReport", "campaign"]

_SUFFIX = ".mcap"
_STAGING = ".running-"


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """What is simulated, where the recordings go, and who runs it.

    Attributes:
        function: Gets a `World` whose recorder is on, and the parameters by name: that of a module, or a `FileFunction`; or
            the path of a script for CARLA's client, which runs against a server of its own.
        out: The folder of the recordings, or the URL of a prefix of an object store.
        town: The name of a map or an .xodr file; None for the built-in town.
        maps: The folder of maps.
        duration: The simulated time in s up to which a world ticks on when the function has returned.
        additional_data: Record velocities, boxes and physics, too.
        date: The date of the recordings in Unix seconds; None: 2026-01-01 10:00 UTC, or $SOURCE_DATE_EPOCH.
        limit: The most seconds for a run, which is ended then; None: any number.
        jobs: The number of worker processes; None: as many as there are processors.
        client: Dask's client, whose cluster is used instead of processes of this machine.
        scoring: How the recordings are scored; None: they get no score.
        again: Make recordings anew that were made with another function, code, town, duration or additional data.
        carla: The release of CARLA that a script is served, such as "0.9.15"; "auto": that of its client.
        python: The path of a script's interpreter, as of an environment with another client; None: that of this package.
    """

    function: Callable[..., object] | str | Path
    out: str | Path
    town: str | None = None
    maps: str | Path | None = None
    duration: float = 0.0
    additional_data: bool = False
    date: int | None = None
    limit: float | None = None
    jobs: int | None = None
    client: Client | None = None
    scoring: Scoring | None = None
    again: bool = False
    carla: str = "auto"
    python: str | Path | None = None

    @property
    def folder(self) -> DestinationFolder:
        """The folder of the recordings."""
        folder = DestinationFolder(os.fspath(self.out), _SUFFIX)
        if self.client is not None and not is_remote(folder.location):
            folder.location = os.path.abspath(folder.location)  # noqa: PTH100
        return folder

    def run(self, runs: Iterable[CampaignRun]) -> Generator[FinishedRun]:
        """Yield runs as they are finished, in their order; those whose recording is there are not simulated again.

        Args:
            runs: The runs, which may be asked for one by one.

        Raises:
            RecapError: The recordings cannot be written there, or one that is there was made with something else; the town
                is missing, the worker processes do not start, or the cluster is gone.
        """
        location = self.folder.location
        present = _sizes(location)
        with _staging(location) as staging:
            simulation = self._simulation(staging)
            if isinstance(runs, Sequence):  # before other runs are made
                first = next((run for run in runs if run.name in present), None)
                if first is not None and not self.again:
                    _check_origin(first, simulation.other_origin(first))
            known = (replace(run, size=present.get(run.name)) for run in runs)
            limit = float("inf") if self.limit is None else self.limit
            with closing(map_sources(simulation, known, jobs=self.jobs, client=self.client, limit=limit)) as outcomes:
                for outcome in outcomes:
                    assert isinstance(outcome.source, CampaignRun)
                    report = outcome.value or RunReport(error=outcome.error)
                    _check_origin(outcome.source, report.other_origin)
                    if report.error is not None:
                        error = report.error.removeprefix(f"{outcome.source.location}: ")
                        report = replace(report, error=visible(error))
                    yield FinishedRun(outcome.source, report, tuple(map(visible, outcome.warnings)))

    def _simulation(self, staging: str | None) -> Simulation:
        from carla_recap.sim import World  # noqa: F401 - which is an error here, and not in each run, without its extra

        return Simulation(
            campaign=replace(
                self,
                function=self.function if callable(self.function) else os.path.abspath(self.function),  # noqa: PTH100
                python=os.path.abspath(self.python or sys.executable),  # noqa: PTH100
                maps=None if self.maps is None else os.path.abspath(self.maps),  # noqa: PTH100
                date=seeded_date() if self.date is None else self.date,
                client=None,
            ),
            staging=staging,
            made_with=made_with(self),
        )


class CampaignKeywords(TypedDict, total=False):
    """The fields of `Campaign` that are options of `campaign`."""

    town: str | None
    maps: str | Path | None
    duration: float
    additional_data: bool
    date: int | None
    limit: float | None
    jobs: int | None
    client: Client | None
    scoring: Scoring | None
    again: bool
    carla: str
    python: str | Path | None


def campaign(
    function: Callable[..., object] | str | Path,
    *,
    seeds: Sequence[int],
    out: str | Path,
    params: Mapping[str, Sequence[Value]] | None = None,
    **options: Unpack[CampaignKeywords],
) -> Generator[FinishedRun]:
    """Yield the runs of a function with all combinations of seeds and values of parameters, as they are finished.

    Each run gives a recording, such as `seed=7,speed=8.mcap`; those that are there are not simulated again. A run that fails
    has an error in its report, and others go on. In scripts, this is called below `if __name__ == "__main__":`.

    Args:
        function: Is called as `function(world, **params)` in a worker process, with a `World` whose recorder is on; or the
            path of a script for CARLA's client.
        seeds: The seeds of the worlds.
        out: The folder of the recordings, or a prefix of an object store.
        params: The values of each parameter.
        options: Further attributes of `Campaign`, such as `duration`, `limit`, `jobs` and `client`.

    Raises:
        RecapError: There are too many runs, the function lacks a parameter, or the recordings cannot be written there.
    """
    values = {name: tuple(given) for name, given in (params or {}).items()}
    for name in values:
        check_name(name)
    if callable(function) and not isinstance(function, FileFunction):
        check_keywords(keywords_of(function), [*values])
    made = Campaign(function=function, out=out, **options)
    return made.run(list(planned(seeds, values, made.folder.location)))


def _check_origin(run: CampaignRun, other: str | None) -> None:
    """Refuse the recording of a run that was made with something else."""
    if other is not None:
        raise RecapError(f"{run.location}: {other}")


def _sizes(location: str) -> dict[str, int]:
    """Return the sizes of the recordings in a folder, by name."""
    if not is_remote(location):
        folder = Path(location)
        names = folder.glob(f"*{_SUFFIX}") if folder.is_dir() else ()
        return {path.name: path.stat().st_size for path in names if path.is_file()}
    from carla_recap.formats.remote import list_objects

    found = list_objects(location, location)
    return {each.location[len(location) :].lstrip("/"): each.size for each in found}


@contextmanager
def _staging(location: str) -> Iterator[str | None]:
    """Yield a folder for recordings that are not complete, which is removed in the end; None for an object store."""
    if is_remote(location):
        yield None
        return
    folder = Path(location, f"{_STAGING}{os.urandom(4).hex()}")
    with made_folder(location), ExitStack() as stack:
        with writing(location):
            stack.enter_context(scratch_folder(folder, folder.parent.glob(f"{_STAGING}????????")))
        yield str(folder)
