"""Commands that write a file for each recording: of one, or of many into a folder, in processes or on a Dask cluster."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from carla_recap.cli import options
from carla_recap.cli.many import SourcesRequest, is_one
from carla_recap.cli.output import counted, end, json_of_written, note, wrote
from carla_recap.fleet.outcomes import WrittenFile
from carla_recap.util.files import size_of

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping

    from carla_recap.exports import ExportFormat
    from carla_recap.fleet.datasets import WritePart
    from carla_recap.fleet.destinations import Write
    from carla_recap.fleet.outcomes import Outcome

_options = options.together(
    options.argument("sources", "SOURCE...", type=click.Path(allow_dash=True), nargs=-1),
    options.destination,
    options.force,
    options.flag("--newer", help="Skip recordings whose file is there and newer; replace older files."),
    options.jobs,
    options.dask,
    options.written,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class WriteRequest(SourcesRequest):
    """The arguments and options of commands that write a file for each recording."""

    destination: str  # a file, or the folder of many; a path or a URL
    force: bool  # replace what is there
    newer: bool  # skip recordings whose file is newer, and replace what is older

    def __post_init__(self) -> None:
        if not self.sources:
            raise click.MissingParameter(param_hint="'DST'", param_type="argument")
        if not self.destination:
            raise click.BadParameter("a path or a URL was expected.", param_hint="'DST'")

    @property
    def has_many(self) -> bool:
        """Whether there may be many recordings, by the form of the sources."""
        from carla_recap.formats.sources import split_time

        return len(self.sources) > 1 or not is_one(split_time(self.sources[0])[0])

    @property
    def is_into_folder(self) -> bool:
        """Whether the destination is a folder: there are many recordings, it ends with a slash, or it is there."""
        from carla_recap.formats.sources import is_remote

        if self.has_many or self.destination.endswith("/"):
            return True
        return not is_remote(self.destination) and Path(self.destination).is_dir()

    def write(self, write: Write, suffix: str | None, usual: str, title: str) -> None:
        """Write the file of the only recording, or those of many into the folder, with the suffix, or else the usual one."""
        if self.is_into_folder:
            self.write_many(write, f".{suffix or usual}", title)
        elif suffix is None:
            self.write_one(write)
        else:
            raise click.UsageError("--to goes with a folder.")

    def write_one(self, write: Write) -> None:
        """Write the file, or the folder, of the only recording, and say so."""
        from carla_recap.fleet.destinations import is_current, write_file
        from carla_recap.fleet.sources import find_sources

        if self.newer and is_current(self.destination, next(find_sources(self.sources))):
            note(f"{self.destination}: is newer than its recording")
            return
        written = write_file(write, self.sources[0], self.destination, force=self.force or self.newer)
        for hint in written.hints:
            note(hint)
        _say(written)

    def write_many(self, write: Write, suffix: str, title: str) -> None:
        """Write a file for each recording into the folder, and say so; end the program with exit code 2 if one fails."""
        from carla_recap.fleet.destinations import DestinationFolder, write_files

        folder = DestinationFolder(self.destination, suffix, force=self.force, newer=self.newer)
        self._run(partial(write_files, _anywhere(write), folder=folder), title, folder.skipped)

    def write_dataset(self, write: WritePart, form: ExportFormat, split: Mapping[str, float] | None) -> None:
        """Write a dataset of all recordings, and say so; end the program with exit code 2 if one fails."""
        from carla_recap.fleet.datasets import write_dataset

        how: dict[str, Any] = {"folder": self.destination, "form": form, "split": split, "force": self.force}
        self._run(partial(write_dataset, _anywhere(write), **how), "sensing")

    def _run(
        self, write: Callable[..., Generator[Outcome[WrittenFile]]], title: str, skipped: list[str] | None = None
    ) -> None:
        """Go through the recordings, and say what is written and what fails; end the program with exit code 2 if one does.

        The files that are skipped grow meanwhile; None: the recordings are written together.
        """
        parts, failed = list[WrittenFile](), list[dict[str, str]]()
        with self.reading(title, write) as (outcomes, messages):
            for outcome in outcomes:
                messages.add(outcome.source.location, outcome.warnings, outcome.error)
                if outcome.value is None:
                    failed.append({"source": outcome.source.location, "error": str(outcome.error)})
                    continue
                parts.append(outcome.value)
                if skipped is not None:
                    with messages.bar.aside():
                        _say(outcome.value)
        messages.end()
        if skipped is None:
            frames, seconds = sum(part.frames or 0 for part in parts), sum(part.seconds or 0.0 for part in parts)
            size, about = size_of(self.destination), counted(len(parts), "recording")
            wrote(self.destination, about, frames=frames, seconds=seconds, size=size)
        for hint in dict.fromkeys(hint for part in parts for hint in part.hints):
            note(hint)
        note(f"recordings: {len(parts)} done, {len(skipped or ())} skipped, {len(failed)} failed")
        if (listed := json_of_written()) is not None:
            listed |= {"skipped": list(skipped or ()), "failed": failed}
        if failed:
            end(failed=True)


def _anywhere(write: Callable[..., WrittenFile]) -> Callable[..., WrittenFile]:
    """Return what writes a file in another process, with the user's own models there, too."""
    from carla_recap.scene.models import models_directory

    models = models_directory()
    return write if models is None else partial(_with_models, models, write)


def _with_models(directory: Path, write: Callable[..., WrittenFile], *arguments: Any) -> WrittenFile:
    from carla_recap.scene.models import use_models

    use_models(directory)
    return write(*arguments)


def _say(written: WrittenFile) -> None:
    wrote(written.path, *written.notes, frames=written.frames, seconds=written.seconds, size=written.size, **written.facts)


writes = options.together(_options, options.merged("request", lambda: WriteRequest))
"""The arguments and options of commands that write a file for each recording, as a `WriteRequest`."""
