"""The low-poly models of actors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, overload

from carla_recap.scene.models.cars import CARS
from carla_recap.scene.models.cycles import CYCLES
from carla_recap.scene.models.people import PEOPLE
from carla_recap.scene.models.props import PROPS
from carla_recap.scene.models.signs import SIGNS
from carla_recap.scene.models.solid import Model
from carla_recap.scene.models.street import STREET
from carla_recap.scene.models.trucks import TRUCKS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.scene.models.solid import Make


class _Models(Sequence[Model]):
    """Models, each of which is made when it is first asked for."""

    def __init__(self, makes: Mapping[str, Make]) -> None:
        self._makes = list(makes.items())
        self._made: dict[int, Model] = {}

    def __len__(self) -> int:
        return len(self._makes)

    @overload
    def __getitem__(self, index: int) -> Model: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Model]: ...

    def __getitem__(self, index: int | slice) -> Model | Sequence[Model]:
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        number = range(len(self))[index]
        if number not in self._made:
            name, make = self._makes[number]
            self._made[number] = make().model(name)
        return self._made[number]

    def __reduce__(self) -> tuple[type[tuple[Model, ...]], tuple[list[Model]]]:
        return tuple, (list(self),)


_ALL: Final = {**STREET, **CARS, **TRUCKS, **CYCLES, **PEOPLE, **PROPS, **SIGNS}

MODELS: Final[Sequence[Model]] = _Models(_ALL)
"""All models; `Instances.models` are indices of them."""

INDEX: Final[dict[str, int]] = {name: index for index, name in enumerate(_ALL)}
"""The index of each model by its name."""

__all__ = ["INDEX", "MODELS", "Model"]
