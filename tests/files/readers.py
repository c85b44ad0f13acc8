"""Datasets, read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image


def size_of(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return image.size


def kitti_labels(folder: Path, index: int) -> list[tuple[str, np.ndarray]]:
    lines = (folder / "training" / "label_2" / f"{index:06}.txt").read_text().splitlines()
    found = [(line.split()[0], np.array(line.split()[1:], np.float64)) for line in lines]
    assert all(len(numbers) == 14 for _, numbers in found)
    return found


def kitti_calibration(folder: Path, index: int) -> dict[str, np.ndarray]:
    lines = (folder / "training" / "calib" / f"{index:06}.txt").read_text().splitlines()
    found = {name: np.array(values.split(), np.float64) for name, values in (line.split(":") for line in lines)}
    return {name: values.reshape(3, -1) for name, values in found.items()}
