"""The models of actors: those of `viewer/models/`, and a user's own, which are glTF, too.

The axes of glTF are x to the left, y up and z forward. What a material or a node means goes by its name: a material named
like one of `Material` (`paint`, `brake light`) has its gloss, its tag, and its glow while it is lit; `paint` has the actor's
colour. A node whose name begins with `steered` turns with the steering, about the vertical axis through its origin.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, overload

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.blueprints import plain_name
from carla_recap.scene.gltf import MOST_BYTES, MOST_TRIANGLES, InvalidGltf, Part, read_glb
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.scene.mesh import Mesh
from carla_recap.util.resources import viewer_folder
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from numpy.typing import NDArray

_OURS: Final = (2, 0, 1)  # where forward, left and up are in glTF's axes
_LEAST: Final = 1e-6  # m, of half a size
_BLUEPRINTS: Final = ("vehicle.", "walker.", "static.")


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh that stands for actors of a class."""

    name: str  # a short name, such as `sedan`
    # the mesh, which fills the box from -1 to 1 along each axis: x forward, y left, z up. Its normals are those of the
    # scaled-down mesh: divided by the half extents of a box and normalised, they are those in the box
    mesh: Mesh
    steered: NDArray[np.bool_]  # whether each vertex belongs to a steered wheel, (vertices,)
    # the x and y of the axis about which each vertex is steered, 0 of one that is not, (vertices, 2)
    pivots: NDArray[np.float32]
    size: tuple[float, float, float]  # the size in m, along each axis, of which its proportions are right
    # the middle of the box of that size, from the origin of the actor that it stands for, in m
    center: tuple[float, float, float]


class Models(Sequence[Model]):
    """Models, each of which is read when it is first asked for."""

    def __init__(self, files: Sequence[Path] = ()) -> None:
        self._models: list[Path | Model] = list(files)

    def __len__(self) -> int:
        return len(self._models)

    @overload
    def __getitem__(self, index: int) -> Model: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Model]: ...

    def __getitem__(self, index: int | slice) -> Model | Sequence[Model]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        found = self._models[index]
        if isinstance(found, Path):
            found = self._models[index] = load_model(found)
        return found

    def append(self, model: Model) -> int:
        """Add a model, and return its index."""
        self._models.append(model)
        return len(self._models) - 1


_FILES: Final = sorted((viewer_folder() / "models").glob("*.glb"))

MODELS: Final = Models(_FILES)
"""All models of this package, then those of users; `Instances.models` are indices of them."""

INDEX: Final[dict[str, int]] = {file.stem.replace("_", " "): index for index, file in enumerate(_FILES)}
"""The indices of this package's models by their names."""

_directory: Path | None = None  # of the user's own models in use
_own: dict[str, int] = {}  # and their indices, by blueprint
_added: dict[tuple[Path, int, int], int] = {}  # the indices of all users' models, by path, time and size


def own_models() -> list[Model]:
    """Return the models that users have added, in the order of their indices."""
    return list(MODELS[len(INDEX) :])


def own_model(type_id: str) -> int | None:
    """Return the index of the user's own model for a blueprint; None without one."""
    return _own.get(plain_name(type_id)) if _own else None


def use_models(directory: Path | str | None) -> None:
    """Draw actors with models of one's own from now on, in this process: in pictures, videos, Rerun and Foxglove.

    Args:
        directory: A folder of files in binary glTF 2.0, each named after a blueprint, such as `vehicle.tesla.model3.glb`. A
            model is scaled to the box of the actor that it stands for. None: only the models of this package.

    Raises:
        RecapError: A file is broken or too large, has what is not supported, or is not named after a blueprint.
    """
    found: dict[str, int] = {}
    triangles = 0
    for path in [] if directory is None else _own_files(Path(directory)):
        try:
            state = path.stat()
        except OSError as error:
            raise RecapError(f"{visible(str(path))}: the model cannot be read: {error.strerror}") from None
        key = path.resolve(), state.st_mtime_ns, state.st_size
        if key not in _added:
            _added[key] = MODELS.append(load_model(path))
        found[plain_name(path.stem)] = _added[key]
        triangles += len(MODELS[_added[key]].mesh.triangles)
        if triangles > MOST_TRIANGLES:
            raise RecapError(f"{directory}: the models have more than {MOST_TRIANGLES:,} triangles in all")
    global _directory
    _directory = None if directory is None else Path(directory).absolute()
    _own.clear()
    _own.update(found)


def models_directory() -> Path | None:
    """Return the folder of the user's own models in use, for other processes; None without one."""
    return _directory


def _own_files(directory: Path) -> list[Path]:
    try:
        files = sorted(path for path in directory.iterdir() if path.suffix == ".glb")
    except OSError as error:
        raise RecapError(f"{directory}: a folder of models was expected: {error.strerror}") from None
    if not files:
        raise RecapError(f"{directory}: no models are in this folder: files such as vehicle.tesla.model3.glb were expected")
    for path in files:
        if not path.name.startswith(_BLUEPRINTS):
            raise RecapError(f"{visible(str(path))}: the name of a blueprint was expected, such as vehicle.tesla.model3.glb")
    return files


def load_model(path: Path) -> Model:
    """Return the model in a .glb file.

    Raises:
        RecapError: The file cannot be read, or is no glTF that can be drawn.
    """
    try:
        if not path.is_file() or path.stat().st_size > MOST_BYTES:
            raise InvalidGltf(f"is no file of at most {MOST_BYTES >> 20} MiB")
        parts = [part for part in read_glb(path.read_bytes()) if len(part.triangles)]
        if not parts:
            raise InvalidGltf("has no triangles")
        if np.ptp(np.concatenate([part.positions for part in parts]), axis=0).max() < 2 * _LEAST:
            raise InvalidGltf("has no size: all its vertices are in one place")
    except (InvalidGltf, OSError) as error:
        what = visible(str(error)) if isinstance(error, InvalidGltf) else error.strerror
        raise RecapError(f"{visible(str(path))}: the model {what}") from None
    if any(part.textured for part in parts):
        warnings.warn(
            f"{visible(str(path))}: the textures are not shown: surfaces have their base colour", RecapWarning, stacklevel=2
        )
    return _model(path.stem.replace("_", " "), parts)


def _model(name: str, parts: list[Part]) -> Model:
    """Return a model of triangles: scaled to fill the box from -1 to 1 along each axis."""
    counts = [len(part.positions) for part in parts]
    points, normals = (
        np.concatenate([getattr(part, field) for part in parts])[:, _OURS] for field in ("positions", "normals")
    )
    low, high = points.min(axis=0), points.max(axis=0)
    center, half = (low + high) / 2, np.maximum((high - low) / 2, _LEAST)
    stretched = normals * half
    materials = [_MATERIALS.get(_letters(part.material), Material.PLAIN) for part in parts]
    colors = [part.color or MATERIALS[material].color for part, material in zip(parts, materials, strict=True)]
    offsets = np.cumsum([0, *counts[:-1]])
    mesh = Mesh(
        np.clip((points - center) / half, -1, 1).astype(np.float32),
        (stretched / np.linalg.norm(stretched, axis=1, keepdims=True)).astype(np.float32),
        np.repeat(np.array(materials, np.uint8), counts),
        np.concatenate([part.triangles + np.uint32(offset) for part, offset in zip(parts, offsets, strict=True)]),
        np.repeat(np.array(colors, np.uint8), counts, axis=0),
    )
    steered = np.repeat([part.pivot is not None for part in parts], counts)
    axes = [center[:2] if part.pivot is None else part.pivot[list(_OURS[:2])] for part in parts]
    pivots = np.repeat(((np.array(axes) - center[:2]) / half[:2]).astype(np.float32), counts, axis=0)
    length, width, height = (2 * half).tolist()
    x, y, z = center.tolist()
    return Model(name, mesh, steered, pivots, (length, width, height), (x, y, z))


def _letters(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


_MATERIALS: Final = {_letters(material.name): material for material in Material}
