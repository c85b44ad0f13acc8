"""A run of a campaign in a worker process: a function in a world of its own, or a script against a server of its own."""

from __future__ import annotations

import inspect
import os
import random
import signal
import sys
import traceback
import warnings
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.fleet.campaign.plan import CampaignRun, text_of
from carla_recap.fleet.campaign.results import measured
from carla_recap.formats.sources import is_remote
from carla_recap.recording import open_recording
from carla_recap.roads.files import read_text
from carla_recap.sim.town.loading import find_town
from carla_recap.util.functions import FileFunction
from carla_recap.util.text import single_line, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from carla_recap.fleet.campaign import Campaign
    from carla_recap.fleet.campaign.results import Result
    from carla_recap.fleet.check import CheckedRecording
    from carla_recap.fleet.sources import SourceFile
    from carla_recap.recording import Recording
    from carla_recap.sim import Town

_ROUNDING: Final = 1e-6  # of a tick
_LONGEST: Final = 4000  # characters of what a run printed, and of its traceback, that are kept
_SEEDS: Final = 1 << 32  # of numpy's global generator
_TERMINATED: Final = 128 + signal.SIGTERM
_PREFIX: Final = "campaign."  # of names of what a recording was made with, which no parameter has
_DIGITS: Final = 16  # of hashes
_LONGEST_VALUE: Final = 60  # characters of a value in an error


@dataclass(frozen=True, slots=True)
class RunReport:
    """What became of a run.

    Attributes:
        error: Why there is no recording of all of it, in one line; None if there is one.
        details: The traceback, and the end of what it printed.
        was_there: Whether the recording was there already.
        seconds: The time that it took, in s.
        frames: The number of frames of the recording.
        duration: Its duration, in s.
        results: What was measured in the recording, by name.
        other_origin: What the recording that is there was made with instead, in one line; None if nothing differs.
    """

    error: str | None = None
    details: str = ""
    was_there: bool = False
    seconds: float = 0.0
    frames: int = 0
    duration: float = 0.0
    results: Mapping[str, Result] = field(default_factory=dict)
    other_origin: str | None = None


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A run of a campaign, and what became of it.

    Attributes:
        run: The seed, the parameters, the name of the recording, and its path or URL, the `location`.
        report: What became of it.
        warnings: The warnings, a line each.
        checked: The verdicts of rules on its recording; None without rules.
        page: The path of its incident page, relative to that of the campaign; None without one.
    """

    run: CampaignRun
    report: RunReport
    warnings: tuple[str, ...] = ()
    checked: CheckedRecording | None = None
    page: str | None = None

    @property
    def broken(self) -> tuple[str, ...] | None:
        """The rules that its recording breaks, or that cannot be judged; None without rules."""
        if self.checked is None:
            return None
        return tuple(verdict.rule for verdict in self.checked.verdicts if verdict.status != "pass")


@dataclass(frozen=True, slots=True)
class Simulation:
    """The simulation of the runs of a campaign; called with each run in a worker process."""

    campaign: Campaign  # whose paths are absolute
    staging: str | None  # the folder of recordings that are not complete; None for the one of temporary files
    made_with: Mapping[str, str]  # is written into recordings, beside seed and parameters

    def prepare(self) -> None:
        """Load what all runs in this process need; what fails here fails in each run, with its reason."""
        from carla_recap.sim import World

        with (
            suppress(Exception),
            TemporaryDirectory() as folder,
            World(_town(self.campaign.town, self.campaign.maps)) as world,
        ):
            world.recorder.start(Path(folder, "recording.mcap"), in_process=True)
            world.tick()

    def __call__(self, run: SourceFile) -> RunReport:
        """Make the recording of a run, unless it is there, and measure it."""
        assert isinstance(run, CampaignRun)
        began = perf_counter()
        address = run.address
        if run.size is not None or (not is_remote(address) and Path(address).exists()):
            with open_recording(address) as recording:
                other = difference(recording.header.parameters, self.made_with)
                if other is None:
                    return self._measured(recording, run, RunReport(was_there=True), began)
            if not self.campaign.again:
                return RunReport(other_origin=other)
        with TemporaryDirectory(prefix="run-", dir=self.staging) as folder:
            path = Path(folder, "recording.mcap")
            report = self._simulated(run, path)
            if report.error is not None:
                return replace(report, seconds=perf_counter() - began)
            if is_remote(address):
                from carla_recap.formats.remote import upload

                upload(path, address)
            else:
                path.replace(address)
        with open_recording(address) as recording:
            return self._measured(recording, run, report, began)

    def other_origin(self, run: CampaignRun) -> str | None:
        """Return what the recording of a run was made with instead; None if nothing differs, or if it cannot be read."""
        with suppress(RecapError, OSError), open_recording(run.address) as recording:
            return difference(recording.header.parameters, self.made_with)
        return None

    def _measured(self, recording: Recording, run: CampaignRun, report: RunReport, began: float) -> RunReport:
        """Return a report with what is measured in the recording of a run."""
        try:
            extent, results = recording.reader.extent(), measured(recording, self.campaign.scoring)
        except (RecapError, OSError, MemoryError):
            raise
        except Exception as error:  # whatever a recording causes, the other runs go on
            return replace(report, error=f"its recording cannot be measured: {_line(error, run)}")
        return replace(
            report,
            seconds=perf_counter() - began,
            frames=extent.frames,
            duration=extent.duration,
            results=results,
        )

    def _simulated(self, run: CampaignRun, path: Path) -> RunReport:
        """Simulate a run, and record it to a path; return its error, if there is one."""
        output = path.with_name("output.txt")
        try:
            with _captured(output):
                self._record(run, path)
        except BaseException as error:
            if isinstance(error, SystemExit) and error.code == _TERMINATED:
                raise
            line, details = _line(error, run), _details(error, output)
            if not callable(self.campaign.function) and isinstance(error, RecapError) and details:
                line = f"{line}: {single_line(details.splitlines()[-1])}"
            return RunReport(line.replace(str(path), run.location), details)
        return RunReport()

    def _record(self, run: CampaignRun, path: Path) -> None:
        """Record a run."""
        from carla_recap.sim import World

        warnings.filterwarnings("ignore", "the recording has ended", RecapWarning)  # which is the error of the run
        random.seed(run.seed)
        np.random.seed(run.seed % _SEEDS)
        campaign, process = self.campaign, os.getpid()
        town, parameters = _town(campaign.town, campaign.maps), {**run.texts, **self.made_with}
        with World(town, seed=run.seed, date=campaign.date, maps=campaign.maps, parameters=parameters) as world:
            world.recorder.start(path, campaign.additional_data, in_process=True)
            try:
                if callable(campaign.function):
                    campaign.function(world, **run.parameters)
                else:
                    from carla_recap.fleet.campaign.serving import run_script

                    run_script(campaign, world, run, path)
            finally:
                if os.getpid() != process:  # the function has forked this one
                    os._exit(0)
            while world.elapsed < campaign.duration - _ROUNDING * world.delta:
                world.tick()
            world.stop_recorder()
            if world.recorder.error is not None:
                raise RecapError(str(world.recorder.error).partition("; ")[0])  # what is left of it is removed
        with open_recording(path) as recording:
            if not recording.reader.extent().frames:
                raise RecapError("no tick was recorded; a function that ticks its world was expected, or a duration")


@lru_cache(maxsize=1)
def _town(name: str | None, maps: str | Path | None) -> Town:
    from carla_recap.sim import load_town

    return load_town(name or "", None if maps is None else Path(maps))


@contextmanager
def _captured(path: Path) -> Iterator[None]:
    """Write what this process and its children print in a `with` block into a file."""
    with path.open("wb") as file:
        streams = [(stream, os.dup(number)) for number, stream in ((1, sys.stdout), (2, sys.stderr))]
        try:
            for number, (stream, _) in enumerate(streams, 1):
                stream.flush()
                os.dup2(file.fileno(), number)
            yield
        finally:
            for number, (stream, saved) in enumerate(streams, 1):
                stream.flush()
                os.dup2(saved, number)
                os.close(saved)


def _line(error: BaseException, run: CampaignRun) -> str:
    """Return what an error of a run says, in one line, with its place in the user's file."""
    if isinstance(error, RecapError):
        return run.as_given(str(error))
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if not frame.filename.startswith((str(Path(__file__).parents[2]), "<"))]
    place = f" ({Path(own[-1].filename).name}:{own[-1].lineno})" if own else ""
    said = single_line(error)[:_LONGEST]
    return f"{type(error).__name__}{f': {said}' if said else ''}{place}"


def _details(error: BaseException, output: Path) -> str:
    """Return the traceback of an error, and the end of what was printed."""
    trace = "".join(traceback.format_exception(error))[-_LONGEST:] if not isinstance(error, RecapError) else ""
    try:
        printed = output.read_bytes()[-_LONGEST:].decode("utf-8", "replace")
    except OSError:
        printed = ""
    return "\n".join(filter(None, (trace.rstrip(), printed.rstrip())))


# --- what recordings were made with --------------------------------------------------------------------------------------


def made_with(campaign: Campaign) -> dict[str, str]:
    """Return what a campaign makes its recordings with, besides seeds and parameters: no paths, so that machines agree."""
    name, path = _source(campaign.function)
    town, map_file = find_town(campaign.town or "", None if campaign.maps is None else Path(campaign.maps))
    try:
        code = "" if path is None else _hash(path.read_bytes())
    except OSError as error:
        raise RecapError(f"{path}: {error.strerror}; a Python file was expected") from None
    found = {
        "function": name,
        "code": code,
        "town": town,
        "map": _hash(read_text(map_file).encode("utf-8", "surrogateescape")),
        "duration": text_of(float(campaign.duration)),
        "additional_data": text_of(campaign.additional_data),
    }
    return {_PREFIX + key: value for key, value in found.items()}


def difference(parameters: Mapping[str, str], expected: Mapping[str, str]) -> str | None:
    """Return how the origin of a recording differs from the expected one, as the line of an error; None if it does not."""
    changed = [name for name, value in expected.items() if parameters.get(name) != value]
    if not changed:
        return None
    advice = "--again (in Python, again=True) makes such recordings anew, or another folder was expected"
    if not any(name.startswith(_PREFIX) for name in parameters):
        return f"is there already, and does not say which function and code made it; {advice}"
    said = []
    for name in changed:
        key = name.removeprefix(_PREFIX)
        before, now = (visible(each.get(name, ""))[:_LONGEST_VALUE] or "none" for each in (parameters, expected))
        label = "map file" if key == "map" else key.replace("_", " ")
        said.append(f"other {label}" if key in ("code", "map") else f"{label} {before} instead of {now}")
    return f"is there already, and was made with {', '.join(said)}; {advice}"


def _source(function: Callable[..., object] | str | Path) -> tuple[str, Path | None]:
    """Return the name of a function or script, and its file; None if there is none, as of a function typed in."""
    if isinstance(function, (str, os.PathLike)):
        return Path(function).name, Path(function)
    if isinstance(function, FileFunction):
        return function.name, Path(function.path)
    try:
        file = inspect.getsourcefile(inspect.unwrap(function))
    except TypeError:
        file = None
    name = getattr(function, "__qualname__", type(function).__name__)
    return name, Path(file) if file is not None and Path(file).is_file() else None


def _hash(content: bytes) -> str:
    return sha256(content).hexdigest()[:_DIGITS]
