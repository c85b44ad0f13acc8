"""A test campaign: a folder with many small recordings, some of which are broken in one of ten ways."""

from __future__ import annotations

import shutil
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

SAMPLES: Final = Path(__file__).parents[1] / "samples"
NAMES: Final = ("blocked.mcap", "crash.mcap", "junction.mcap", "crossing.log")
"""The samples that a campaign repeats."""

SPAWNED: Final = 2
"""The number of packets of spawns in a log."""


def make(folder: Path, count: int, broken: int = 0) -> None:
    """Fill a folder with copies of the samples, and with broken recordings among them.

    Args:
        folder: The folder, which must not exist.
        count: The number of files.
        broken: How many of them are broken.
    """
    folder.mkdir(parents=True)
    kinds, names = cycle(BROKEN.items()), cycle(NAMES)
    for number in range(count):
        if number * broken // count != (number + 1) * broken // count:
            name, make_broken = next(kinds)
            make_broken(folder / f"run-{number:05}-{name}")
        else:
            name = next(names)
            shutil.copyfile(SAMPLES / name, folder / f"run-{number:05}-{name}")


def _cut(path: Path) -> None:
    path.write_bytes(_crash()[:300_000])


def _cut_log(path: Path) -> None:
    path.write_bytes((SAMPLES / "crossing.log").read_bytes()[:30])


def _empty(path: Path) -> None:
    path.touch()


def _text(path: Path) -> None:
    path.write_text("The simulation has failed.\n")


def _flipped_in_chunk(path: Path) -> None:
    from mcap.reader import make_reader

    from carla_recap.model.records import UE4

    content = bytearray(_crash())
    with (SAMPLES / "crash.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    (spawns,) = [id for id, channel in summary.channels.items() if channel.topic == UE4.named("spawned").topic]
    chunk = next(chunk for chunk in summary.chunk_indexes if spawns in chunk.message_index_offsets)
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 16
    path.write_bytes(content)


def _flipped_in_summary(path: Path) -> None:
    content = bytearray(_crash())
    content[-300] ^= 16
    path.write_bytes(content)


def _gone(path: Path) -> None:
    path.symlink_to(path.with_name("gone"))


def _of_another_program(path: Path) -> None:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/tf", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()


def _begun(path: Path) -> None:
    path.write_bytes(_crash()[:8])


def _too_many_spawns(path: Path) -> None:
    """Write a log whose first packet of spawns has fewer than it says."""
    from carla_recap.formats.carla_log import LogReader, pack_header

    content = bytearray((SAMPLES / "crossing.log").read_bytes())
    reader = LogReader(SAMPLES / "crossing.log")
    offset = len(pack_header(reader.header))
    reader.close()
    while content[offset] != SPAWNED:
        offset += 5 + int.from_bytes(content[offset + 1 : offset + 5], "little")
    content[offset + 5 : offset + 7] = b"\xff\xff"
    path.write_bytes(content)


def _crash() -> bytes:
    return (SAMPLES / "crash.mcap").read_bytes()


BROKEN: Final[dict[str, Callable[[Path], None]]] = {
    "cut.mcap": _cut,
    "cut.log": _cut_log,
    "empty.log": _empty,
    "text.log": _text,
    "flipped-in-chunk.mcap": _flipped_in_chunk,
    "flipped-in-summary.mcap": _flipped_in_summary,
    "gone.mcap": _gone,
    "of-another-program.mcap": _of_another_program,
    "begun.mcap": _begun,
    "too-many-spawns.log": _too_many_spawns,
}
"""What writes a broken recording, by the end of its name."""
