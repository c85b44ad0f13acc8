"""The registry of calls: one entry per remote procedure, made from the signature of its handler."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from carla_recap.errors import RecapError
from carla_recap.server.rpc.codec import Convert, DecodeError, decoder, encoder

Handler = Callable[..., Any]


class CallError(RecapError):
    """A call that cannot be served; the client raises a RuntimeError with this text."""


@dataclass(frozen=True, slots=True)
class Call:
    """A remote procedure.

    Attributes:
        name: The name in CARLA's protocol.
        handler: The function that serves it, called with the client and the arguments.
        arguments: The decoders of the arguments.
        result: The encoder of the answer; None if the answer is only that the call is done.
        least: The number of required arguments.
        bare: Whether the answer is sent without the wrapping of CARLA's `Response`.
    """

    name: str
    handler: Handler
    arguments: tuple[Convert, ...]
    result: Convert | None
    least: int
    bare: bool = False

    def __call__(self, client: Any, arguments: list[Any]) -> Any:
        """Serve a call and return the answer, not yet encoded; surplus arguments, as of newer clients, are ignored.

        Raises:
            RecapError: There are too few arguments, or one is of another type, or the call cannot be served.
        """
        if len(arguments) < self.least:
            raise DecodeError(f"{self.name}: expected {self.least} arguments, found {len(arguments)}")
        try:
            decoded = [convert(value) for convert, value in zip(self.arguments, arguments, strict=False)]
        except DecodeError:
            raise self._argument_error(arguments) from None
        return self.handler(client, *decoded)

    def _argument_error(self, arguments: list[Any]) -> DecodeError:
        """Return the error of the first argument that cannot be decoded."""
        for number, (convert, value) in enumerate(zip(self.arguments, arguments, strict=False), 1):
            try:
                convert(value)
            except DecodeError as error:
                return DecodeError(f"{self.name}, argument {number}: {error}")
        raise AssertionError


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
    arguments = tuple(decoder(type) for type in tuple(hints.values())[1:])
    least = len(arguments) - len(handler.__defaults__ or ())
    encode = None if result is type(None) else encoder(result)
    return Call(handler.__name__, handler, arguments, encode, least, bare)


def _register(handler: Handler, *, bare: bool) -> Handler:
    entry = unregistered_call(handler, bare=bare)
    assert entry.name not in CALLS
    CALLS[entry.name] = entry
    return handler
