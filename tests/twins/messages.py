"""Payloads ↔ protobuf messages, one packet at a time, each value set and read by protobuf's own library."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carla_recap.formats.mcap.codec import message_class
from carla_recap.model.layout import Framing, Layout, Many, pack, unpack
from carla_recap.model.records import UE4, UE5, RecordType

TYPES = [
    type
    for table in (UE4, UE5)
    for type in table
    if type.id > 1 and not type.opaque and (not type.wide or type.layout.has_reals)
]
"""The record types whose packets are messages of their own."""
every_type = pytest.mark.parametrize("type", TYPES, ids=lambda type: type.name + "_wide" * type.wide)


def encoded(type: RecordType, payload: bytes, frame: int, elapsed: float) -> bytes:
    """Return the message of a payload, which has all of the payload in `raw` where its records do not give it back."""
    message: Any = message_class(type.name, type.message_name)(frame=frame, elapsed=elapsed)
    records, _ = unpack(type, payload)
    if type.framing is Framing.SINGLE:
        setattr(message, type.items, records[0].item()[0])
    else:
        _fill(getattr(message, type.items), records, type.layout)
    if decoded(type, message.SerializeToString()) != payload:
        message.raw = payload
    data: bytes = message.SerializeToString()
    return data


def decoded(type: RecordType, data: bytes) -> bytes:
    """Return the payload of a message."""
    message: Any = message_class(type.name, type.message_name).FromString(data)
    if message.raw:
        payload: bytes = message.raw
        return payload
    found = getattr(message, type.items)
    if type.framing is Framing.SINGLE:
        return np.array([found], type.dtype.fields[type.items][0]).tobytes()  # type: ignore[index]
    rows = [_record(item, type.layout, wide=type.wide) for item in found]
    return pack(type, np.array([tuple(row) for row in rows], type.dtype) if type.fixed else rows)


def _fill(items: Any, records: Any, layout: Layout) -> None:
    for record in records:
        item = items.add()
        for name, kind in layout.fields.items():
            value = record[name].item() if isinstance(record, np.void) else getattr(record, name)
            if isinstance(kind, Many):
                _fill(getattr(item, name), value, _layout_of(value, kind))
            elif isinstance(value, str):
                setattr(item, name, value.encode("utf-8", "surrogateescape").decode("utf-8", "replace"))
            else:
                setattr(item, name, bool(value) if kind == "flag" else value)


def _layout_of(records: Any, kind: Many) -> Layout:
    names = records.dtype.names if isinstance(records, np.ndarray) else None
    return next((each for each in kind.layouts if tuple(each.fields) == names), kind.layouts[0])


def _record(item: Any, layout: Layout, *, wide: bool) -> Any:
    values: list[Any] = []
    for name, kind in layout.fields.items():
        value = getattr(item, name)
        if isinstance(kind, Many):
            complete = (each for each in kind.layouts if value and all(map(value[0].HasField, each.fields)))
            inner = next(complete, kind.layouts[0])
            rows = [_record(each, inner, wide=wide) for each in value]
            value = rows if inner.make else np.array([tuple(row) for row in rows], inner.dtype(wide))
        values.append(value)
    return layout.make(*values) if layout.make else values
