"""The blueprints of CARLA 0.9.16 that have a body, as tables, and the sizes and boxes of actors.

`vehicles.csv`, `walkers.csv` and `props.csv` beside this module list them, and `other_names.csv` the vehicles that other
releases, up to 0.9.11 and 0.10, have under another name.
"""

from __future__ import annotations

import csv
import math
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

from carla_recap.model.lives import BoundingBox
from carla_recap.model.records import ActorKind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.model.lives import ActorLife

BlueprintKind = Literal["vehicles", "walkers", "props"]
Size = tuple[float, float, float]
"""Length, width and height in m."""

_HALF_SIZES: Final[dict[int, Size]] = {
    ActorKind.VEHICLE: (2.25, 0.95, 0.75),
    ActorKind.WALKER: (0.25, 0.25, 0.9),
    ActorKind.TRAFFIC_LIGHT: (0.2, 0.2, 0.5),
    ActorKind.TRAFFIC_SIGN: (0.05, 0.4, 0.4),
    ActorKind.SENSOR: (0.1, 0.1, 0.1),
}
"""Half of the usual length, width and height in m of each kind of actor."""
_TWO_WHEELS: Final = (1.0, 0.4, 0.8)
_SIMILAR: Final = 0.3  # m, of length and half the width, by which vehicles of about the same size differ
_SMALL: Final = (0.15, 0.15, 0.15)

_PREFIXES: Final[dict[BlueprintKind, str]] = {"vehicles": "vehicle", "walkers": "walker", "props": "static.prop"}


def blueprint_rows(table: BlueprintKind | Literal["other_names"]) -> list[dict[str, str]]:
    """Return the rows of a table; their ids lack the prefix of the family."""
    with Path(__file__).with_name(f"{table}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@cache
def blueprint_sizes() -> Mapping[str, Size]:
    """Return the sizes of CARLA's boxes, or close to them, by blueprint; the length and width of a walker are the same."""
    return MappingProxyType(
        {
            f"{prefix}.{row['id']}": (float(row.get("length", row["width"])), float(row["width"]), float(row["height"]))
            for table, prefix in _PREFIXES.items()
            for row in blueprint_rows(table)
        }
    )


def plain_name(type_id: str) -> str:
    """Return a blueprint without what has changed between versions of CARLA: mkz2017, mkz_2017."""
    return type_id.replace("_", "").replace("-", "").lower()


@cache
def other_names() -> Mapping[str, str]:
    """Return the blueprints of 0.9.16 by the names that other releases have for them, or for similar vehicles."""
    return MappingProxyType({f"vehicle.{row['id']}": f"vehicle.{row['like']}" for row in blueprint_rows("other_names")})


def blueprint_size(type_id: str) -> Size | None:
    """Return the size of a blueprint, however its version of CARLA writes it; None of an unknown one."""
    return blueprint_sizes().get(type_id) or _plain_sizes().get(plain_name(type_id))


@cache
def _plain_sizes() -> dict[str, Size]:
    sizes = blueprint_sizes()
    others = {plain_name(type_id): sizes[like] for type_id, like in other_names().items()}
    return others | {plain_name(type_id): size for type_id, size in sizes.items()}


def blueprint_box(type_id: str, kind: int) -> BoundingBox | None:
    """Return the box of a blueprint; None of an unknown one."""
    size = blueprint_size(type_id)
    return None if size is None else _box(type_id, kind, (size[0] / 2, size[1] / 2, size[2] / 2))


def box_of(actor: ActorLife) -> BoundingBox:
    """Return the box of an actor: as recorded, else that of its blueprint, else the usual one of its kind.

    The usual vehicle is 4.5 m long and 1.9 m wide, one of two wheels 2 m and 0.8 m, and a walker 0.5 m and 0.5 m.
    """
    if actor.bounding_box is not None:
        return actor.bounding_box
    known = blueprint_box(actor.type_id, actor.spawn.kind)
    if known is not None:
        return known
    kind = (
        ActorKind.SENSOR if actor.type_id.startswith("sensor.") else actor.spawn.kind
    )  # older versions of CARLA record OTHER
    is_bike = kind == ActorKind.VEHICLE and actor.attributes.get("number_of_wheels") == "2"
    return _box(actor.type_id, kind, _TWO_WHEELS if is_bike else _HALF_SIZES.get(kind, _SMALL))


def blueprint_like(family: str, length: float, width: float, number: int) -> str:
    """Return a blueprint that can stand for a vehicle or walker of which the size alone is known, in m, NaN if unknown.

    The family is CARLA's base type: car, van, truck, bus, motorcycle, bicycle; or vehicle for any of these; or walker. The
    number chooses among those of about this size, so that they differ.
    """
    if family == "walker":
        rows = _walkers()
        return rows[number % len(rows)]
    if math.isnan(length) and family == "vehicle":
        family = "car"
    misfits = [
        (type_id, 0.0 if math.isnan(length) else abs(size[0] - length) + (abs(size[1] - width) / 2 if width > 0 else 0.0))
        for type_id, base_type, size in _civil_vehicles()
        if family in (base_type, "vehicle")
    ]
    least = min(misfit for _, misfit in misfits)
    similar = [type_id for type_id, misfit in misfits if misfit <= least + _SIMILAR]
    return similar[number % len(similar)]


@cache
def _walkers() -> list[str]:
    return [f"walker.{row['id']}" for row in blueprint_rows("walkers") if row["age"] == "adult"]


@cache
def _civil_vehicles() -> list[tuple[str, str, Size]]:
    return [
        (f"vehicle.{row['id']}", row["base_type"], blueprint_sizes()[f"vehicle.{row['id']}"])
        for row in blueprint_rows("vehicles")
        if row["special_type"] in ("", "electric")
    ]


def _box(type_id: str, kind: int, half: Size) -> BoundingBox:
    """Return a box whose lower side is on the ground; that of a walker or a sensor is around its location."""
    is_centered = kind in (ActorKind.WALKER, ActorKind.SENSOR) or type_id.startswith("walker.")
    return BoundingBox(0.0, 0.0, 0.0 if is_centered else half[2], *half)
