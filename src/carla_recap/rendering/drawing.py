"""What the process that draws runs; see `carla_recap.rendering.process`."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

from carla_recap.errors import RecapError
from carla_recap.rendering.renderer import Renderer, create_context
from carla_recap.scene.models import MODELS, Models
from carla_recap.util.child import answer_requests

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.rendering.camera import Images
    from carla_recap.rendering.process import DrawingSetup, DrawnMoment


def _prepare(setup: DrawingSetup) -> Callable[[DrawnMoment], Callable[[], list[Images]]]:
    """Return what returns what draws a moment."""
    models = MODELS if setup.loads_models else Models()
    for model in setup.models:
        models.append(model)
    renderer = Renderer(setup.tiles, models=models, quality=setup.quality, supersampling=setup.supersampling)

    def draw(moment: DrawnMoment) -> list[Images]:
        return [
            renderer.draw(view.camera, moment.instances, view.kinds, moment.sky, view.previous, without=view.without)
            for view in moment.views
        ]

    return lambda moment: partial(draw, moment)


if __name__ == "__main__":
    with suppress(RecapError):  # which is found again when there is something to draw
        _context = create_context()  # the driver is loaded while the parent prepares the town
    answer_requests(_prepare)
