"""The registry of calls: one entry per remote procedure, made from the signature of its handler."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import cache
from types import UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin, get_type_hints

from carla_recap.errors import RecapError
from carla_recap.server.rpc.codec import Convert, DecodeError, decoder, encoder

if TYPE_CHECKING:
    from carla_recap.server.protocol.releases import Release

Handler = Callable[..., Any]


class CallError(RecapError):
    """A call that cannot be served; the client raises a RuntimeError with this text."""


@dataclass(frozen=True, slots=True)
class Call:
    """A remote procedure, whose handler is called with the client and the arguments.

    Attributes:
        result: The type of the answer; None if the answer is only that the call is done.
        least: The number of required arguments.
        bare: Whether the answer is sent without the wrapping of CARLA's `Response`.
    """

    name: str
    handler: Handler
    arguments: tuple[Any, ...]
    result: Any
    least: int
    bare: bool = False

    def __call__(self, client: Any, arguments: list[Any]) -> Any:
        """Serve a call and return the answer, not yet encoded; surplus arguments, as of newer clients, are ignored.

        A `RecapError` is raised if there are too few arguments, one is of another type, or the call cannot be served.
        """
        if len(arguments) < self.least:
            raise DecodeError(f"{self.name}: expected {self.least} arguments, found {len(arguments)}")
        decoded: list[Any] = []
        try:
            for convert, value in zip(_decoders(self.arguments, client.release), arguments, strict=False):
                decoded.append(convert(value))
        except DecodeError as error:
            raise DecodeError(f"{self.name}, argument {len(decoded) + 1}: {error}") from None
        return self.handler(client, *decoded)

    def encoded(self, client: Any, answer: Any) -> Any:
        """Return an answer as it is sent to a client: as CARLA's `Response`, unless it is bare."""
        if self.result is None:
            return [[False]]
        value = encoder(self.result, client.release)(answer)
        return value if self.bare else [[1, value]]


@cache
def _decoders(types: tuple[Any, ...], release: Release) -> tuple[Convert, ...]:
    return tuple(decoder(type, release) for type in types)


CALLS: dict[str, Call] = {}
"""All calls by name."""


def call(handler: Handler) -> Handler:
    """Register a handler under its own name; its annotations are the types of its arguments and its answer."""
    return _register(handler, bare=False)


def bare_call(handler: Handler) -> Handler:
    """Register a handler whose answer is not wrapped."""
    return _register(handler, bare=True)


def unregistered_call(handler: Handler, *, bare: bool = False) -> Call:
    """Return the call of a handler, as `call` would register it."""
    hints = get_type_hints(handler)
    result = hints.pop("return")
    alternatives = get_args(result) if get_origin(result) in (Union, UnionType) else ()
    if any(get_origin(alternative) is Awaitable for alternative in alternatives):
        result = alternatives[0]
    elif get_origin(result) is Awaitable:
        (result,) = get_args(result)
    arguments = tuple(hints.values())[1:]
    least = len(arguments) - len(handler.__defaults__ or ())
    return Call(handler.__name__, handler, arguments, None if result is type(None) else result, least, bare)


def _register(handler: Handler, *, bare: bool) -> Handler:
    entry = unregistered_call(handler, bare=bare)
    assert entry.name not in CALLS
    CALLS[entry.name] = entry
    return handler
