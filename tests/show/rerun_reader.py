"""The content of files of Rerun, read with Rerun's own reader."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rerun", reason="the extra rerun is not installed")

from rerun.chunk import RrdReader


class Rrd:
    """The content of an .rrd, as the viewer sees it."""

    def __init__(self, path: Path) -> None:
        self.reader = RrdReader(path)
        self._rows = defaultdict(lambda: defaultdict(list))  # by entity, by component: time, order, value
        self.static = defaultdict(dict)
        self.chunks = self.reader.stream().to_chunks()
        for chunk in self.chunks:
            batch = chunk.to_record_batch()
            columns = batch.to_pydict()
            ids = columns.pop("rerun.controls.RowId")
            columns.pop("frame", None)
            times = [time.value for time in columns.pop("sim_time")] if "sim_time" in columns else None
            for name, values in columns.items():
                if times is None:
                    self.static[chunk.entity_path][name] = values[-1]
                else:
                    self._rows[chunk.entity_path][name] += zip(times, ids, values, strict=True)

    @property
    def entities(self) -> set[str]:
        return {chunk.entity_path for chunk in self.chunks}

    def rows(self, entity: str, component: str) -> list[tuple[float, list]]:
        """Return seconds and values."""
        rows = sorted(row for row in self._rows[entity][component] if row[2] is not None)
        return [(time / 1e9, value) for time, _, value in rows]

    def at(self, entity: str, component: str, seconds: float) -> list | None:
        """Return the latest value at a time; None if there is none, or it was cleared."""
        until = round(seconds * 1e9)
        parents = [entity, *map(str, Path(entity).parents)]
        clears = [row[:2] for parent in parents for row in self._rows[parent]["Clear:is_recursive"] if row[0] <= until]
        rows = [row for row in self._rows[entity][component] if row[0] <= until and row[2] is not None]
        last = max(rows, default=None)
        return None if last is None or last[:2] < max(clears, default=last[:2]) else last[2]

    def place(self, entity: str, seconds: float) -> list[float] | None:
        found = self.at(entity, "Transform3D:translation", seconds)
        return found and found[0]

    def angle(self, entity: str, seconds: float) -> float:
        """Return the yaw, in degrees."""
        ((x, y, z, w),) = self.at(entity, "Transform3D:quaternion", seconds)
        return float(np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))


class Arrangement:
    """The content of a blueprint."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        (self.store,) = reader.blueprints()
        self.parts = defaultdict(dict)
        for chunk in reader.stream(store=self.store).to_chunks():
            self.parts[chunk.entity_path] |= chunk.to_record_batch().to_pylist()[-1]

    def view(self, name: str) -> SimpleNamespace:
        (path,) = [path for path, part in self.parts.items() if part.get("ViewBlueprint:display_name") == [name]]
        eye = {
            key.partition(":")[2]: value[0]
            for key, value in self.parts[f"{path}/EyeControls3D"].items()
            if key.startswith("EyeControls3D")
        }
        ranged = [part.split("/overrides")[1] for part in self.parts if part.startswith(f"{path}/ViewContents/overrides")]
        return SimpleNamespace(origin=self.parts[path]["ViewBlueprint:space_origin"][0], **eye, ranged=ranged)

    @property
    def active_tab(self) -> str:
        (tab,) = [
            part["ContainerBlueprint:active_tab"][0]
            for part in self.parts.values()
            if part.get("ContainerBlueprint:active_tab")
        ]
        return self.parts[f"/{tab}".replace("//", "/")]["ViewBlueprint:display_name"][0]
