"""Strategies for hypothesis: any recording that the format allows, and damaged ones."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Any

from hypothesis import strategies as st

from carla_recap.formats.carla_log import pack_header
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.layout import Framing
from carla_recap.model.records import UE4, UE5, Group
from tests.samples import listed, text

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

    from carla_recap.model.records import RecordType, Table

# A cut or surplus byte here and there, but mostly sound packets.
surplus = st.one_of(st.just(b""), st.just(b""), st.binary(max_size=3))
texts = st.one_of(
    st.text(max_size=8).map(str.encode),
    st.binary(max_size=8),
    st.sampled_from([b"", b"\0", b"role_name", b"\xff\xfe", b"\xed\xa0\x80", b"x" * 300]),
)
real64 = st.one_of(
    st.floats(0, 20), st.floats(), st.binary(min_size=8, max_size=8).map(lambda data: struct.unpack("<d", data)[0])
)


def reals(table: Table, count: int) -> SearchStrategy[bytes]:
    """Return numbers of any bits; some are signalling NaNs, of which protobuf makes quiet ones."""
    nan = struct.pack("<Q", 0x7FF2 << 48) if table.wide else struct.pack("<I", 0x7FA2 << 16)
    return st.one_of(sized(count * len(nan)), st.just(nan * count))


def sized(count: int) -> SearchStrategy[bytes]:
    return st.binary(min_size=count, max_size=count)


def counted(code: str, item: SearchStrategy[bytes], most: int) -> SearchStrategy[bytes]:
    return st.lists(item, max_size=most).map(lambda items: struct.pack(code, len(items)) + b"".join(items))


flags = st.one_of(st.sampled_from([b"\0", b"\1"]), sized(1))


def joined(*parts: SearchStrategy[bytes]) -> SearchStrategy[bytes]:
    return st.tuples(*parts).map(b"".join)


def spawn_records(table: Table) -> SearchStrategy[bytes]:
    attribute = joined(sized(1), texts.map(text), texts.map(text))
    return joined(sized(5), reals(table, 6), sized(4), texts.map(text), counted("<H", attribute, 3))


def bone_records(table: Table) -> SearchStrategy[bytes]:
    return joined(sized(4), counted("<H", joined(texts.map(text), reals(table, 6)), 3))


def wheel_records() -> SearchStrategy[bytes]:
    location = st.one_of(st.sampled_from([b"\0", b"\3"]), sized(1))
    return joined(sized(4), counted("<I", joined(location, sized(8)), 6))


def physics_packets() -> SearchStrategy[list[bytes]]:
    """Return strategies for both layouts of wheels; a packet has one of them."""

    def of(numbers: int) -> SearchStrategy[bytes]:
        curve, wheels = counted("<I", sized(8), 2), counted("<I", reals(UE4, numbers), 4)
        return joined(sized(24), flags, sized(28), curve, counted("<I", sized(12), 2), curve, wheels)

    return st.one_of(st.lists(of(12), max_size=2), st.lists(of(9), max_size=2))


def fixed_records(type: RecordType) -> SearchStrategy[bytes]:
    """Return any bytes; half of them are small values, such as flags and states."""
    size = type.dtype.itemsize
    return st.one_of(st.lists(st.integers(0, 1), min_size=size, max_size=size).map(bytes), sized(size))


def payloads(type: RecordType, table: Table, extra: SearchStrategy[bytes] = surplus) -> SearchStrategy[bytes]:
    """Return payloads of a type, some with bytes after the records."""
    if type.opaque:
        return st.binary(max_size=40)
    if type.framing is Framing.SINGLE:
        body = fixed_records(type)
    elif type.fixed:
        body = st.lists(fixed_records(type), max_size=3).map(lambda records: listed(*records))
    elif type.name == "physics":
        body = physics_packets().map(lambda records: listed(*records))
    else:
        record = {"spawned": spawn_records(table), "walker_bones": bone_records(table), "wheels": wheel_records()}[type.name]
        body = st.lists(record, max_size=3).map(lambda records: listed(*records))
    return joined(body, extra)


def known_types(table: Table) -> list[RecordType]:
    """Return the record types of packets within a frame."""
    return [type for type in table if type.id > 1]


def packets(table: Table, extra: SearchStrategy[bytes] = surplus) -> SearchStrategy[Packet]:
    known = st.sampled_from(known_types(table)).flatmap(
        lambda type: payloads(type, table, extra).map(lambda payload: Packet(type.id, type, payload))
    )
    empty = st.sampled_from([type for type in known_types(table) if type.framing is Framing.LIST]).map(
        lambda type: Packet(type.id, type, b"\0\0")
    )
    unknown = st.tuples(st.integers(len(table), 255), st.binary(max_size=20)).map(
        lambda found: Packet(found[0], None, found[1])
    )
    end = st.just(Packet(1, table[1], b""))
    return st.one_of(known, known, empty, unknown, end)


def varied(packet: Packet, number: int) -> Packet:
    """Return a packet of the same size with another last byte, if any bytes are its records."""
    if packet.type is None or not packet.type.fixed or len(packet.payload) < 3:
        return packet
    return Packet(packet.id, packet.type, packet.payload[:-1] + bytes((packet.payload[-1] ^ number % 2,)))


def steady_packets(table: Table) -> SearchStrategy[list[Packet]]:
    """Return packets of different types of states, of small numbers: such as most frames of a recording have."""
    types = [type for type in known_types(table) if type.group is Group.STATE and type.fixed and type.topic]

    def filled(type: RecordType) -> SearchStrategy[Packet]:
        record = st.lists(st.integers(0, 1), min_size=type.dtype.itemsize, max_size=type.dtype.itemsize).map(bytes)
        body = record if type.framing is Framing.SINGLE else st.lists(record, max_size=3).map(lambda found: listed(*found))
        return body.map(lambda payload: Packet(type.id, type, payload))

    some = st.lists(st.sampled_from(types), max_size=5, unique_by=lambda type: type.id)
    return some.flatmap(lambda found: st.tuples(*map(filled, found)).map(list))


def frame_lists(
    table: Table, first: list[Packet], elapsed: SearchStrategy[float] = real64, alike: tuple[int, ...] = (1,)
) -> SearchStrategy[list[Frame]]:
    """Return frames, each as often as one of some numbers, but for its times and a number in each packet.

    The first packets are given, so that the reader can detect the dialect.
    """

    def build(
        parts: list[tuple[int, float, float, list[Packet], list[float]]], preamble: list[Packet] | None
    ) -> list[Frame]:
        frames = [] if preamble is None else [Frame(0, 0, 0.0, 0.0, first + preamble, preamble=True)]
        for id, at, duration, found, steps in parts:
            for number in range(len(steps)):
                packets = [varied(packet, number) for packet in found]
                packets = packets if frames else first + packets
                frames.append(Frame(len(frames), (id + number) % (1 << 64), at + sum(steps[:number]), duration, packets))
        return frames

    # A frame is what lies between two starts.
    found = st.lists(packets(table), max_size=6)
    if alike != (1,):
        found = st.one_of(found, steady_packets(table), steady_packets(table))
        elapsed = st.one_of(st.floats(0, 20), st.floats(0, 20), elapsed)
    step = st.sampled_from([0.05, 0.05, 0.0, 2.0, -1.0])
    steps = st.sampled_from(alike).flatmap(lambda count: st.lists(step, min_size=count, max_size=count))
    body = st.tuples(st.integers(0, (1 << 64) - 1), elapsed, real64, found, steps)
    preamble = st.one_of(st.none(), st.none(), st.lists(packets(table), max_size=3))
    if not first:
        preamble = st.none()
    return st.builds(build, st.lists(body, max_size=5), preamble)


def headers(*, wide: bool = False, shifted: bool = False) -> SearchStrategy[Header]:
    """Return headers with any name, date and version, some with a magic in lower case."""

    def build(name: bytes, date: int, version: int, small: bool) -> Header:
        header = Header(name.decode("utf-8", "surrogateescape"), date, version, wide, shifted)
        if not small:
            return header
        raw = pack_header(header).replace(b"CARLA_RECORDER", b"carla_recorder", 1)
        return Header(header.map_name, date, version, wide, shifted, raw)

    dates = st.one_of(st.integers(0, 2_000_000_000), st.integers(-(1 << 63), (1 << 63) - 1))
    return st.builds(build, texts, dates, st.integers(0, 0xFFFF), st.booleans())


def signature(*, wide: bool, shifted: bool) -> list[Packet]:
    """Return packets that only one dialect can have: a door, which fits no other type, and a transform."""
    table = UE5 if wide else UE4
    door, transforms = table.named("doors"), table.named("transforms")
    return [
        Packet(door.id, door, listed(bytes(6))),
        Packet(transforms.id, transforms, listed(bytes(transforms.dtype.itemsize))),
    ]


@st.composite
def recordings(draw: st.DrawFn, alike: tuple[int, ...] = (1,)) -> tuple[Header, list[Frame]]:
    """Return a header and frames, in any dialect; see `frame_lists`."""
    wide, shifted = draw(st.sampled_from([(False, False), (False, False), (True, False), (False, True), (True, True)]))
    header = draw(headers(wide=wide, shifted=shifted))
    frames = draw(frame_lists(header.table, signature(wide=wide, shifted=shifted), alike=alike))
    if not frames:
        # Nothing tells the dialect of a recording without a packet.
        header = Header(header.map_name, header.date, header.version, raw=header.raw)
    return header, frames


def clocks(*, jumps: bool) -> SearchStrategy[list[float]]:
    """Return elapsed seconds of frames, increasing or arbitrary."""
    if jumps:
        return st.lists(st.one_of(st.floats(-20, 60), st.sampled_from([0.0, 5.0, math.nan, math.inf])), max_size=20)
    steps = st.lists(st.one_of(st.floats(0.01, 0.1), st.floats(1, 8)), max_size=20)
    return steps.map(lambda found: [sum(found[:count]) for count in range(len(found))])


def mutations(size: int) -> SearchStrategy[list[tuple[str, int, Any]]]:
    """Return ways to damage bytes: offsets and changes."""
    at = st.integers(0, size)
    return st.lists(
        st.one_of(
            st.tuples(st.just("set"), at, st.binary(min_size=1, max_size=8)),
            st.tuples(st.just("insert"), at, st.binary(min_size=1, max_size=30)),
            st.tuples(st.just("delete"), at, st.integers(1, 60)),
            st.tuples(st.just("cut"), at, st.none()),
            st.tuples(st.just("splice"), at, st.integers(0, size)),
        ),
        min_size=1,
        max_size=3,
    )


def damaged(data: bytes, changes: list[tuple[str, int, Any]]) -> bytes:
    """Return the bytes after mutations; see `mutations`."""
    for what, at, value in changes:
        if what == "set":
            data = data[:at] + value + data[at + len(value) :]
        elif what == "insert":
            data = data[:at] + value + data[at:]
        elif what == "delete":
            data = data[:at] + data[at + value :]
        elif what == "cut":
            data = data[:at]
        else:
            data = data[:at] + data[value:]
    return data
