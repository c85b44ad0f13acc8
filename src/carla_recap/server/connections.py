"""All connections together: how many there can be, and how much memory is kept for them."""

from __future__ import annotations

from contextlib import suppress
from typing import Final, Protocol

_MOST: Final = 2000  # connections: each sensor that somebody listens to is one
_SPARE: Final = 100  # files that the process needs for itself
_MOST_HELD: Final = 128 << 20  # bytes


class Connection(Protocol):
    """A connection, as all of them see it."""

    @property
    def has_spoken(self) -> bool:
        """Whether it has been told what it is for."""

    @property
    def held(self) -> int:
        """How many bytes are kept for it."""

    def refuse(self) -> None:
        """Tell it that there are too many."""

    def close(self) -> None:
        """Cut it."""


class Connections:
    """The connections of a server.

    Where there are as many as there can be, those that have never said anything give way to new ones; where there are none
    of these, new ones are refused.
    """

    def __init__(self) -> None:
        self._most = most_connections()
        self._members: dict[Connection, None] = {}

    @property
    def refusal(self) -> str:
        """What who is refused is told."""
        return f"the server has {self._most} connections, which is as many as it can have"

    def enter(self, connection: Connection) -> None:
        """Take in a new connection, or refuse it."""
        if len(self._members) >= self._most:
            silent = next((member for member in self._members if not member.has_spoken), None)
            if silent is None:
                connection.refuse()
            else:
                del self._members[silent]
                silent.close()
        self._members[connection] = None

    def leave(self, connection: Connection) -> None:
        """Let a connection go."""
        self._members.pop(connection, None)

    def check_memory(self) -> None:
        """Cut the connection for which most is kept, where too much is kept for all."""
        if sum(member.held for member in self._members) > _MOST_HELD:
            max(self._members, key=lambda member: member.held).close()


def most_connections() -> int:
    """How many connections there can be, after as many files as possible have been allowed to this process."""
    with suppress(ImportError, OSError, ValueError):  # not on Windows
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = _MOST + _SPARE
        if soft != resource.RLIM_INFINITY and soft < wanted:
            soft = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            return min(_MOST, max(1, soft - _SPARE))
    return _MOST
