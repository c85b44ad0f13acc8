"""Which release a client of this machine is of: its process has loaded CARLA's library, whose texts tell (Linux)."""

from __future__ import annotations

import mmap
from contextlib import suppress
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.server.protocol.releases import RELEASES, Release

if TYPE_CHECKING:
    from collections.abc import Iterator

Address = tuple[str, int]
"""A host and a port."""
_PROCESSES: Final = Path("/proc")
_TABLES: Final = ("net/tcp", "net/tcp6")
_LOCAL, _REMOTE, _INODE = 1, 2, 9  # columns of these tables
_known: Final[dict[tuple[int, int, int], Release | None]] = {}
"""The releases of libraries by device, inode and time of change."""


def release_of(client: Address, server: Address) -> Release | None:
    """Return the release of the client at the other end of a connection.

    It is None on another machine, in a container or a process of another user, or if that has no library of CARLA's.
    """
    if not (client[0].startswith(("127.", "::1", "::ffff:127.")) or client[0] == server[0]):
        return None
    with suppress(OSError, ValueError):  # the latter of an empty file
        for socket in _sockets(client, server):
            for library in _libraries(socket):
                if (release := _release_of_library(library)) is not None:
                    return release
    return None


def _sockets(client: Address, server: Address) -> Iterator[str]:
    """Yield the sockets of this machine from an address to another one, as links of open files name them."""
    ends = [_plain(client), _plain(server)]
    for table in _TABLES:
        with suppress(OSError):
            for line in (_PROCESSES / table).read_text().splitlines()[1:]:
                columns = line.split()
                if columns[_INODE] != "0" and [_address(columns[end]) for end in (_LOCAL, _REMOTE)] == ends:
                    yield f"socket:[{columns[_INODE]}]"


def _address(text: str) -> Address:
    """Return an address of a table, such as 0100007F:07D0: words of four bytes, the last byte first."""
    host, _, port = text.rpartition(":")
    words = bytes.fromhex(host)
    return _plain((str(ip_address(b"".join(words[at : at + 4][::-1] for at in range(0, len(words), 4)))), int(port, 16)))


def _plain(address: Address) -> Address:
    """Return an address with its host in one form: without a zone, and as one of IPv4 if it is one."""
    host = ip_address(address[0].partition("%")[0])
    mapped = host.ipv4_mapped if isinstance(host, IPv6Address) else None
    return str(mapped or host), address[1]


def _libraries(socket: str) -> Iterator[Path]:
    """Yield what may be CARLA's library in each process that has a socket open, the latest process first."""
    numbers = (int(folder.name) for folder in _PROCESSES.iterdir() if folder.name.isdecimal())
    for folder in (_PROCESSES / str(number) for number in sorted(numbers, reverse=True)):
        with suppress(OSError):  # it is another user's, or has ended
            if any(_target(link) == socket for link in (folder / "fd").iterdir()):
                mapped = (line.split(maxsplit=5)[5:] for line in (folder / "maps").read_text().splitlines())
                for path in dict.fromkeys(Path(name) for names in mapped for name in names):
                    if "carla" in path.name and ".so" in path.suffixes:
                        yield folder / "root" / path.relative_to("/")


def _target(link: Path) -> str:
    with suppress(OSError):
        return str(link.readlink())
    return ""


def _release_of_library(path: Path) -> Release | None:
    state = path.stat()
    key = state.st_dev, state.st_ino, state.st_mtime_ns
    if key not in _known:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as code:
            _known[key] = next((release for release in RELEASES if code.find(release.marker) >= 0), None)
    return _known[key]
