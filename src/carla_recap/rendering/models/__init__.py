"""The low-poly models of actors."""

from __future__ import annotations

from typing import Final

from carla_recap.rendering.models.cars import cars
from carla_recap.rendering.models.people import people
from carla_recap.rendering.models.solid import Model
from carla_recap.rendering.models.street import street

MODELS: Final[tuple[Model, ...]] = tuple(solid.model(name) for name, solid in (*street(), *cars(), *people()))
"""All models; `Instances.models` are indices of them."""

INDEX: Final[dict[str, int]] = {model.name: index for index, model in enumerate(MODELS)}
"""The index of each model by its name."""

__all__ = ["INDEX", "MODELS", "Model"]
