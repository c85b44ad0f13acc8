"""The low-poly models of actors."""

from __future__ import annotations

from typing import Final

from carla_recap.rendering.models.cars import cars
from carla_recap.rendering.models.cycles import cycles
from carla_recap.rendering.models.people import people
from carla_recap.rendering.models.props import props
from carla_recap.rendering.models.signs import signs
from carla_recap.rendering.models.solid import Model
from carla_recap.rendering.models.street import street
from carla_recap.rendering.models.trucks import trucks

MODELS: Final[tuple[Model, ...]] = tuple(
    solid.model(name) for name, solid in (*street(), *cars(), *trucks(), *cycles(), *people(), *props(), *signs())
)
"""All models; `Instances.models` are indices of them."""

INDEX: Final[dict[str, int]] = {model.name: index for index, model in enumerate(MODELS)}
"""The index of each model by its name."""

__all__ = ["INDEX", "MODELS", "Model"]
