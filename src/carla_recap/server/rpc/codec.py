"""Conversion between Python's types and the MessagePack values of CARLA's protocol.

A struct, here a dataclass, is an array of its fields in order. An optional value is `[false]` or `[true, value]`. A struct
may have more fields than expected, as newer clients send them, and fewer if fields have defaults. What else a release of the
client has differently is in its row of `protocol.releases`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from math import isfinite
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from carla_recap.errors import RecapError
from carla_recap.server.protocol.releases import AttributeCode, Label, Labels, Release

Convert = Callable[[Any], Any]


class EncodedText(bytearray):
    """A text as bytes: to encode a long one keeps all clients waiting, unless it is done in a thread, part by part."""


class DecodeError(RecapError):
    """A received value is not of the expected type."""


@cache
def decoder(type: Any, release: Release) -> Convert:
    """Return what converts an unpacked value of a release to a type; it raises `DecodeError` for a value of another type."""
    origin, inner = get_origin(type), get_args(type)
    if type is Any:
        return _as_is
    if type is float:
        return _decode_float
    if type in (int, bool, str, bytes):
        return _scalar(type)
    if type is Label:
        return _decode_label(release)
    if type is AttributeCode:
        return lambda value: _scalar(int)(value) - release.first_attribute_type
    if type in release.structs:
        foreign = decoder(release.structs[type], release)
        return lambda value: foreign(value).plain()
    if is_dataclass(type):
        return _decode_struct(type, release)
    if origin in (Union, UnionType):
        return _decode_optional(decoder(_present(inner), release))
    if origin is list:
        return _decode_list(decoder(inner[0], release), list)
    if origin is tuple and inner[1:] == (...,):
        return _decode_list(decoder(inner[0], release), tuple)
    if origin is tuple:
        return _decode_tuple(tuple(decoder(part, release) for part in inner))
    raise TypeError(f"{type}: no type of the protocol")


@cache
def encoder(type: Any, release: Release) -> Convert:
    """Return what converts a value of a type to one that can be packed for a release."""
    origin, inner = get_origin(type), get_args(type)
    if type in (Any, float, int, bool, str, bytes, EncodedText):
        return _as_is
    if type in (Label, Labels):
        return _encode_labels(type, release)
    if type is AttributeCode:
        return lambda value: value + release.first_attribute_type
    if type in release.structs:
        foreign, own = release.structs[type], encoder(release.structs[type], release)
        return lambda value: own(foreign.of(value))
    if is_dataclass(type):
        return _encode_struct(type, release)
    if origin in (Union, UnionType):
        present = encoder(_present(inner), release)
        return lambda value: [False] if value is None else [True, present(value)]
    if origin is list or (origin is tuple and inner[1:] == (...,)):
        each = encoder(inner[0], release)
        return _as_is if each is _as_is else lambda values: [each(value) for value in values]
    if origin is tuple:
        parts = tuple(encoder(part, release) for part in inner)
        if all(part is _as_is for part in parts):
            return _as_is
        return lambda values: [part(value) for part, value in zip(parts, values, strict=True)]
    raise TypeError(f"{type}: no type of the protocol")


def _as_is(value: Any) -> Any:
    return value


def _present(alternatives: tuple[Any, ...]) -> Any:
    (type,) = (alternative for alternative in alternatives if alternative is not NoneType)
    return type


def _decode_float(value: Any) -> float:
    if value.__class__ in (float, int):
        if not isfinite(value):
            raise DecodeError(f"expected a finite number, found {value}")
        return float(value)
    raise DecodeError(f"expected a number, found {_shown(value)}")


def _scalar(type: type) -> Convert:
    def decode(value: Any) -> Any:
        if value.__class__ is not type:
            raise DecodeError(f"expected {type.__name__}, found {_shown(value)}")
        return value

    return decode


def _decode_label(release: Release) -> Convert:
    """Return what converts a label of a release to the first of ours that is the same."""
    labels = release.labels
    integer = _scalar(int)
    return lambda value: labels.index(value) if integer(value) in labels else value


def _encode_labels(type: Any, release: Release) -> Convert:
    labels = release.labels
    if not labels:
        return _as_is
    return (lambda value: labels[value]) if type is Label else lambda value: bytes(labels[tag] for tag in value)


def _fields(type: Any, release: Release) -> dict[str, Any]:
    """Return the types of the fields that a struct has in a release."""
    hints = get_type_hints(type)
    return {each.name: hints[each.name] for each in fields(type) if f"{type.__name__}.{each.name}" not in release.without}


def _decode_struct(type: Any, release: Release) -> Convert:
    types = _fields(type, release)
    kinds = list(types.values())
    parts = [(name, decoder(kind, release)) for name, kind in types.items()]
    numeric = set(kinds) <= {float, int, bool}
    least = sum(each.default is MISSING and each.default_factory is MISSING for each in fields(type))
    name = type.__name__

    def decode(value: Any) -> Any:
        if numeric and value.__class__ is list and [item.__class__ for item in value] == kinds and all(map(isfinite, value)):
            return type(*value)
        if value.__class__ is not list or len(value) < least:
            raise DecodeError(f"expected a {name} of {len(parts)} fields, found {_shown(value)}")
        return type(**{key: part(item) for (key, part), item in zip(parts, value, strict=False)})

    return decode


def _encode_struct(type: Any, release: Release) -> Convert:
    parts = [(name, encoder(kind, release)) for name, kind in _fields(type, release).items()]
    if all(part is _as_is for _, part in parts):
        names = [name for name, _ in parts]
        return lambda value: [getattr(value, name) for name in names]
    return lambda value: [part(getattr(value, name)) for name, part in parts]


def _decode_optional(inner: Convert) -> Convert:
    def decode(value: Any) -> Any:
        if value.__class__ is list and value[:1] == [False]:
            return None
        if value.__class__ is list and len(value) == 2 and value[0] is True:
            return inner(value[1])
        raise DecodeError(f"expected an optional value, found {_shown(value)}")

    return decode


def _decode_list(each: Convert, make: Callable[[Any], Any]) -> Convert:
    def decode(value: Any) -> Any:
        if value.__class__ is not list:
            raise DecodeError(f"expected an array, found {_shown(value)}")
        return make(each(item) for item in value)

    return decode


def _decode_tuple(parts: tuple[Convert, ...]) -> Convert:
    def decode(value: Any) -> Any:
        if value.__class__ is not list or len(value) != len(parts):
            raise DecodeError(f"expected an array of {len(parts)}, found {_shown(value)}")
        return tuple(part(item) for part, item in zip(parts, value, strict=True))

    return decode


def _shown(value: Any) -> str:
    if isinstance(value, (list, dict, str, bytes)):
        return f"{type(value).__name__} of {len(value)}"
    return repr(value)
