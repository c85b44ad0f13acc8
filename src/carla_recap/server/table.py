"""The table of calls: a row per remote procedure, made from the signature of its handler."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, get_args, get_origin, get_type_hints

from carla_recap.errors import RecapError
from carla_recap.server.wire import Convert, WireError, decoder, encoder

Handler = Callable[..., Any]


class CallError(RecapError):
    """A call that cannot be served; the client raises a RuntimeError with its text."""


@dataclass(frozen=True, slots=True)
class Call:
    """A remote procedure.

    Attributes:
        name: What clients call it.
        handler: What serves it: it gets the client and the arguments.
        arguments: What decodes them.
        result: What encodes the answer; None where there is none but that it is done.
        least: How many arguments there must be.
        bare: Whether the answer goes out without the wrapping of CARLA's `Response`.
    """

    name: str
    handler: Handler
    arguments: tuple[Convert, ...]
    result: Convert | None
    least: int
    bare: bool = False

    def __call__(self, client: Any, arguments: list[Any]) -> Any:
        """Serve a call; returns what is to be wrapped.

        Raises:
            RecapError: The arguments are not what was expected, or it cannot be served.
        """
        if len(arguments) < self.least:
            raise WireError(f"{self.name}: expected {self.least} arguments, found {len(arguments)}")
        try:
            decoded = [convert(value) for convert, value in zip(self.arguments, arguments, strict=False)]
        except WireError:
            raise self._misfit(arguments) from None
        return self.handler(client, *decoded)

    def _misfit(self, arguments: list[Any]) -> WireError:
        """What is wrong with arguments that cannot be decoded."""
        for number, (convert, value) in enumerate(zip(self.arguments, arguments, strict=False), 1):
            try:
                convert(value)
            except WireError as error:
                return WireError(f"{self.name}, argument {number}: {error}")
        raise AssertionError


TABLE: dict[str, Call] = {}
"""All calls by their names."""


def call(handler: Handler) -> Handler:
    """Enter a handler in the table, under its name; its annotations say what goes over the wire."""
    return _enter(handler, bare=False)


def bare_call(handler: Handler) -> Handler:
    """Enter a handler whose answer is not wrapped."""
    return _enter(handler, bare=True)


def row(handler: Handler, *, bare: bool = False) -> Call:
    """The row of a handler, as it would be in the table; see `call`."""
    hints = get_type_hints(handler)
    result = hints.pop("return")
    if get_origin(result) is Awaitable:
        (result,) = get_args(result)
    arguments = tuple(decoder(type) for type in tuple(hints.values())[1:])
    least = len(arguments) - len(handler.__defaults__ or ())
    encode = None if result is type(None) else encoder(result)
    return Call(handler.__name__, handler, arguments, encode, least, bare)


def _enter(handler: Handler, *, bare: bool) -> Handler:
    entry = row(handler, bare=bare)
    assert entry.name not in TABLE
    TABLE[entry.name] = entry
    return handler
