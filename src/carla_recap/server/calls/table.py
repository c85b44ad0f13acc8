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
        decoded = []
        for number, (convert, value) in enumerate(zip(self.arguments, arguments, strict=False), 1):
            try:
                decoded.append(convert(value))
            except WireError as error:
                raise WireError(f"{self.name}, argument {number}: {error}") from None
        return self.handler(client, *decoded)


TABLE: dict[str, Call] = {}
"""All calls by their names."""


def call(handler: Handler) -> Handler:
    """Enter a handler in the table, under its name; its annotations say what goes over the wire."""
    return _enter(handler, bare=False)


def bare_call(handler: Handler) -> Handler:
    """Enter a handler whose answer is not wrapped."""
    return _enter(handler, bare=True)


def _enter(handler: Handler, *, bare: bool) -> Handler:
    hints = get_type_hints(handler)
    result = hints.pop("return")
    if get_origin(result) is Awaitable:
        (result,) = get_args(result)
    arguments = tuple(decoder(type) for type in tuple(hints.values())[1:])
    least = len(arguments) - len(handler.__defaults__ or ())
    name = handler.__name__
    assert name not in TABLE
    TABLE[name] = Call(name, handler, arguments, None if result is type(None) else encoder(result), least, bare)
    return handler
