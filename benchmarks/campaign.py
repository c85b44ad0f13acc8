"""A test campaign: a folder with many small recordings, some of which are broken in one of ten ways."""

from __future__ import annotations

import shutil
from io import BytesIO
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.formats.carla_log import LogReader, pack_header
from carla_recap.model.records import UE4

if TYPE_CHECKING:
    from collections.abc import Callable

SAMPLES: Final = Path(__file__).parents[1] / "samples"
NAMES: Final = ("blocked.mcap", "crash.mcap", "junction.mcap", "crossing.log")
"""The samples that a campaign repeats."""
CRASH: Final = SAMPLES / "crash.mcap"
CROSSING: Final = SAMPLES / "crossing.log"


def make(folder: Path, count: int, broken: int = 0) -> None:
    """Fill a new folder with a number of copies of the samples, some of which are broken."""
    folder.mkdir(parents=True)
    kinds, names = cycle(BROKEN.items()), cycle(NAMES)
    for number in range(count):
        if number * broken // count != (number + 1) * broken // count:
            name, content = next(kinds)
            path = folder / f"run-{number:05}-{name}"
            if content is None:
                path.symlink_to(path.with_name("gone"))
            else:
                path.write_bytes(content())
        else:
            name = next(names)
            shutil.copyfile(SAMPLES / name, folder / f"run-{number:05}-{name}")


def _flipped(offset: int) -> bytes:
    content = bytearray(CRASH.read_bytes())
    content[offset] ^= 16
    return bytes(content)


def _in_chunk() -> int:
    """Return the offset of the middle of the chunk with the spawns."""
    from mcap.reader import make_reader

    with CRASH.open("rb") as file:
        summary = make_reader(file).get_summary()
    (spawns,) = [id for id, channel in summary.channels.items() if channel.topic == UE4.named("spawned").topic]
    chunk = next(chunk for chunk in summary.chunk_indexes if spawns in chunk.message_index_offsets)
    return chunk.chunk_start_offset + chunk.chunk_length // 2


def _of_another_program() -> bytes:
    from mcap.writer import Writer

    file = BytesIO()
    writer = Writer(file)
    writer.start()
    writer.add_message(writer.register_channel("/tf", "json", 0), 0, b"{}", 0)
    writer.finish()
    return file.getvalue()


def _too_many_spawns() -> bytes:
    """Return a log whose first packet of spawns has fewer than it says."""
    content = bytearray(CROSSING.read_bytes())
    reader = LogReader(CROSSING)
    offset = len(pack_header(reader.header))
    reader.close()
    while content[offset] != UE4.named("spawned").id:
        offset += 5 + int.from_bytes(content[offset + 1 : offset + 5], "little")
    content[offset + 5 : offset + 7] = b"\xff\xff"
    return bytes(content)


BROKEN: Final[dict[str, Callable[[], bytes] | None]] = {
    "cut.mcap": lambda: CRASH.read_bytes()[:300_000],
    "cut.log": lambda: CROSSING.read_bytes()[:30],
    "empty.log": lambda: b"",
    "text.log": lambda: b"The simulation has failed.\n",
    "flipped-in-chunk.mcap": lambda: _flipped(_in_chunk()),
    "flipped-in-summary.mcap": lambda: _flipped(-300),
    "gone.mcap": None,
    "of-another-program.mcap": _of_another_program,
    "begun.mcap": lambda: CRASH.read_bytes()[:8],
    "too-many-spawns.log": _too_many_spawns,
}
"""What makes the content of a broken recording, by the end of its name; None: it is a link that leads nowhere."""
