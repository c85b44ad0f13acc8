"""Road networks from OpenDRIVE files: the surfaces of paved lanes and junctions, and speed limits."""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import FormatError, RecapWarning
from carla_recap.roads import network as roads
from carla_recap.roads.cells import LARGEST_GAP, find_areas
from carla_recap.roads.corridors import is_of_corridors
from carla_recap.roads.files import content_digest, expecting, read_parts
from carla_recap.roads.find import find_map
from carla_recap.roads.network import LANE_KINDS, RoadNetwork
from carla_recap.roads.opendrive import BEFORE_END, borders_at, read_opendrive, sparse_sections
from carla_recap.roads.speed_limits import lane_limits, limit_signs
from carla_recap.roads.stop_lines import signal_tables
from carla_recap.util.cache import kept

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.roads.drawing import RoadMap
    from carla_recap.roads.opendrive import Road
    from carla_recap.util.arrays import Floats

    Lane = tuple[int, int, int]

_SPACING: Final = 1.0  # m between the points at which the course of a road is examined
_MOST_POINTS: Final = 300_000  # at which roads are examined
_MOST_PIECES: Final = 400_000  # about; of longer roads, each piece is longer
_NARROW: Final = 0.02  # m

_CELL: Final = 0.5  # m
_COARSEST: Final = 2.0  # m of a cell
_MOST_CELLS_OF_ALL: Final = 3_000_000  # of all junctions, about
_MOST_GAPS: Final = 200_000  # pieces that fill gaps, of all junctions


def load_road_network(path: Path | str, lane_types: frozenset[str] | None = None) -> RoadNetwork:
    """Return the road network of an OpenDRIVE file.

    Args:
        path: The file, such as `Town01.xodr`.
        lane_types: The OpenDRIVE types of the lanes that it has, lower-case; None: those that are paved, and what the lanes
            of junctions enclose.

    Raises:
        RecapError: The file cannot be read, or is no OpenDRIVE map with lanes for cars.
    """
    path = Path(path)
    return _network(_Source(path.stem, content_digest(path), path, lane_types=lane_types))


def find_road_network(
    map_name: str, folder: Path | str | None = None, lane_types: frozenset[str] | None = None
) -> RoadNetwork | None:
    """Return the road network of the map of a recording, or None if its file is unknown; see `find_map`.

    Args:
        map_name: The name of the map.
        folder: The folder of maps.
        lane_types: See `load_road_network`.

    Raises:
        RecapError: The file cannot be read, or is no OpenDRIVE map with lanes for cars.
    """
    path = find_map(map_name, folder)
    return None if path is None else load_road_network(path, lane_types)


def road_network_of(opendrive: str, name: str = "") -> RoadNetwork:
    """Return the road network of the text of an OpenDRIVE file; a `FormatError` if it is no map with lanes for cars."""
    digest = sha256(opendrive.encode("utf-8", "replace")).digest()
    return _network(_Source(name, digest, Path(name or "map"), text=opendrive))


def road_network_of_map(road_map: RoadMap | None) -> RoadNetwork | None:
    """Return the road network of a map; None if there is none: of no map, of corridors, and of a map without lanes."""
    if road_map is None or not road_map.opendrive or is_of_corridors(road_map.opendrive):
        return None
    with suppress(FormatError):
        return road_network_of(road_map.opendrive, road_map.name)
    return None


@dataclass(frozen=True)
class _Source:
    """Where a map is: sources of equal names and contents are equal."""

    name: str
    digest: bytes
    path: Path = field(compare=False)
    lane_types: frozenset[str] | None = None
    text: str | None = field(default=None, compare=False)


_TABLES: Final = ("lanes", "pieces", "signals", "stop_lines")
_IDS: Final = ("road_ids", "junction_ids", "signal_ids")


@lru_cache(4)
def _network(source: _Source) -> RoadNetwork:
    path = source.path
    types = source.lane_types

    def make() -> dict[str, list[NDArray[Any]]]:
        made = vars(build_network(read_parts(path) if source.text is None else source.text, "", types))
        return {name: [np.asarray(made[name])] for name in (*_TABLES, *_IDS)}

    with expecting(path):
        arrays = kept(source.digest, f"network {'' if types is None else sorted(types)}", ("roads",), make)
    tables: dict[str, Any] = {name: arrays[name][0] for name in _TABLES}
    ids: dict[str, Any] = {name: tuple(arrays[name][0].astype(str).tolist()) for name in _IDS}
    network = RoadNetwork(source.name, **tables, **ids)
    if source.lane_types is None and not np.isin(network.lanes["kind"], (roads.DRIVING, roads.BOTH_WAYS)).any():
        raise FormatError(path, None, "an OpenDRIVE map was expected, and no lane for cars is in it")
    return network


def build_network(text: str | Iterable[str], name: str = "", lane_types: frozenset[str] | None = None) -> RoadNetwork:
    """Return the road network of the text of an OpenDRIVE file, or of its parts; for the types, see `load_road_network`."""
    with np.errstate(all="ignore"):
        found = read_opendrive(text).roads
        names = dict.fromkeys(road.junction for road in found if road.in_junction)
        kinds = LANE_KINDS if lane_types is None else {each: LANE_KINDS.get(each, roads.SHOULDER) for each in lane_types}
        lanes, pieces = _lane_tables(found, {junction: number for number, junction in enumerate(names)}, kinds)
        signals, lines, ids = signal_tables(found)
        network = RoadNetwork(name, lanes, pieces, signals, lines, tuple(road.id for road in found), tuple(names), ids)
        if lane_types is not None:
            return network
        lanes, pieces = _gaps(network)
    return replace(network, lanes=lanes, pieces=pieces)


def _lane_tables(
    found: Sequence[Road], junctions: Mapping[str, int], kinds: Mapping[str, int]
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Return the lanes and the pieces of roads, of lanes of some types, whose kinds are given."""
    rows: list[tuple[int, int, int, int, int]] = []
    parts = [np.zeros(0, roads.PIECE)]
    signs = limit_signs(found)
    for number, road, section, sparse in sparse_sections(found, _SPACING, _MOST_POINTS, _MOST_PIECES):
        lanes, start, end = section.lanes, section.start, section.end - BEFORE_END
        if not any(lane.kind in kinds for lane in lanes):
            continue
        changes = [*(station for station, _ in road.limits), *(sign.station for sign in signs[number])]
        changes += [start + along for lane in lanes for along, _ in lane.limits]
        stations = np.union1d(sparse, [station for station in changes if start + 0.1 < station < end - 0.1])
        points, offsets, lefts, _ = borders_at(road, section, stations)
        middles, halves = (points[:-1] + points[1:]) / 2, (offsets[:-1] - offsets[1:]) / 2
        junction = junctions[road.junction] if road.in_junction else roads.NONE
        for row, lane in enumerate(lanes):
            if lane.kind in kinds:
                reverse = road.is_reverse(lane.id)
                pieces = _pieces(middles[row], lefts, halves[row], reverse=reverse)
                limits = lane_limits(road, section, lane, signs[number], (stations[1:] + stations[:-1]) / 2)
                pieces["limit"] = limits[::-1] if reverse else limits
                pieces["lane"] = len(rows)
                rows.append((number, road.sections.index(section), lane.id, kinds[lane.kind], junction))
                parts.append(pieces)
    pieces = np.concatenate(parts)
    good = np.maximum(pieces["half0"], pieces["half1"]) > _NARROW / 2
    for name in roads.SHAPE:
        good &= np.isfinite(pieces[name])
    pieces = pieces[good]
    used, pieces["lane"] = np.unique(pieces["lane"], return_inverse=True)
    return np.array(rows, roads.LANE)[used], pieces


def _pieces(middle: Floats, lefts: Floats, half: Floats, *, reverse: bool) -> NDArray[np.void]:
    """Return the pieces of a lane, (n - 1,), between points, (n,)."""
    if reverse:
        middle, lefts, half = middle[::-1], -lefts[::-1], half[::-1]
    pieces = np.zeros(len(middle) - 1, roads.PIECE)
    for end, part in (("0", slice(None, -1)), ("1", slice(1, None))):
        pieces[f"x{end}"], pieces[f"y{end}"], pieces[f"z{end}"] = middle[part].T
        pieces[f"left_x{end}"], pieces[f"left_y{end}"], _ = lefts[part].T
        pieces[f"half{end}"] = half[part]
    return pieces


# --- the gaps between the lanes of junctions -----------------------------------------------------------------------------


def _gaps(network: RoadNetwork) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Return the lanes and pieces of a network, with others for what the lanes of a junction enclose."""
    lanes, pieces, count = [network.lanes], [network.pieces], 0
    junctions = network.lanes["junction"][network.pieces["lane"]]
    order = np.argsort(junctions, kind="stable")
    bounds = np.searchsorted(junctions[order], np.arange(len(network.junction_ids) + 1)).tolist()
    most = _MOST_CELLS_OF_ALL / max(len(network.junction_ids), 1)
    for junction, (first, last) in enumerate(pairwise(bounds)):
        if first == last:
            continue
        of_it = network.pieces[order[first:last]]
        low, high = _extent(of_it)
        cell = max(_CELL, float(np.sqrt((high - low).prod() / most)))
        columns, rows = (np.ceil((high - low) / cell).astype(np.int64) + 1).tolist()
        if cell > _COARSEST or count > _MOST_GAPS:
            limit = f"cells of {cell:.1f} m" if cell > _COARSEST else f"{count:,} pieces before"
            message = f"junction {network.junction_ids[junction]}: gaps between its lanes are no road: {limit}"
            warnings.warn(message, RecapWarning, stacklevel=3)
            continue
        gaps = _enclosed(network, of_it, low, (columns, rows), cell)
        count += len(gaps)
        if len(gaps):
            gaps["lane"] = sum(map(len, lanes))
            lanes.append(np.array([(roads.NONE, 0, 0, roads.GAP, junction)], roads.LANE))
            pieces.append(gaps)
    return np.concatenate(lanes), np.concatenate(pieces)


def _extent(pieces: NDArray[np.void]) -> tuple[Floats, Floats]:
    """Return the corners of the least and largest x and y around pieces."""
    points = np.concatenate([np.stack((pieces[f"x{end}"], pieces[f"y{end}"]), axis=1) for end in "01"])
    reach = float(max(pieces["half0"].max(), pieces["half1"].max())) + 2 * _CELL
    return points.min(axis=0) - reach, points.max(axis=0) + reach


def _enclosed(
    network: RoadNetwork, pieces: NDArray[np.void], low: Floats, shape: tuple[int, int], cell: float
) -> NDArray[np.void]:
    """Return strips that cover the areas which the lanes of a junction enclose, but not those of large islands."""
    columns, rows = shape
    x, y = np.meshgrid(low[0] + np.arange(columns) * cell, low[1] + np.arange(rows) * cell, indexing="ij")
    free = find_areas(~network.on_road(np.stack((x.ravel(), y.ravel()), axis=1)).reshape(shape))
    gaps = free.cells(free.enclosed & (free.sizes * cell**2 <= LARGEST_GAP))
    edges = np.diff(gaps.astype(np.int8), axis=0, prepend=0, append=0)  # rows of squares are one piece each
    first, last = np.argwhere(edges.T > 0), np.argwhere(edges.T < 0)
    strips = np.zeros(len(first), roads.PIECE)
    strips["limit"] = np.nan
    height = np.median(pieces["z0"])
    for end, (line, column) in (("0", first.T), ("1", last.T)):
        strips[f"x{end}"] = low[0] + (column - 0.5) * cell
        strips[f"y{end}"] = low[1] + line * cell
        strips[f"z{end}"], strips[f"left_y{end}"], strips[f"half{end}"] = height, 1.0, cell / 2
    return strips
