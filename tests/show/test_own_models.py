"""Models of one's own: in pictures, in Rerun and in Foxglove; and what is wrong with a folder of them."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from carla_recap import open_recording, use_models
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.lives import BoundingBox
from carla_recap.model.records import ActorKind
from carla_recap.scene.appearance import look_of
from carla_recap.scene.materials import MATERIALS, Material
from carla_recap.scene.models import MODELS
from tests.cli.command import error
from tests.samples import CROSSING, names_in
from tests.scene.glb import boxes, color, glb, square

MAGENTA = (255, 0, 255)
CAR = boxes(
    ({"name": "hull", **color(1, 0, 1)}, (-80, 0, -200), (80, 150, 200)),
    ({"name": "Paint"}, (-60, 150, -100), (60, 190, 100)),
    ({"name": "brake light"}, (-60, 80, -202), (60, 100, -200)),
)
"""A car of boxes: in cm, which does not matter, with a hull in magenta, a roof in the actor's colour, and a lamp."""


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "vehicle.tesla.model3.glb").write_bytes(CAR)
    yield tmp_path / "models"
    use_models(None)


def test_the_model_fills_the_box_of_its_actor(folder):
    box = BoundingBox(0, 0, 0.7, 2.4, 1.1, 0.7)
    ours = look_of("vehicle.tesla.model3", ActorKind.VEHICLE, {"color": "10,20,30"}, box)
    use_models(folder)
    own = look_of("vehicle.tesla.model3", ActorKind.VEHICLE, {"color": "10,20,30"}, box)
    assert own == ours._replace(model=own.model)
    model = MODELS[own.model]
    assert model.size == pytest.approx((402, 160, 190))
    assert (np.abs(model.mesh.vertices).max(axis=0) == 1).all()
    roof, lamp = (model.mesh.materials == number for number in (Material.PAINT, Material.BRAKE_LIGHT))
    assert model.mesh.vertices[roof][:, 2].max() == 1
    assert (model.mesh.vertices[lamp][:, 0] < -0.99).all()
    unlit = MATERIALS[Material.BRAKE_LIGHT].color
    assert {tuple(row) for row in model.mesh.painted((10, 20, 30)).tolist()} == {MAGENTA, (10, 20, 30), unlit}


def test_a_picture_shows_the_model(folder, tmp_path):
    image = pytest.importorskip("PIL.Image", reason="the extra `cameras` is not installed")
    from carla_recap.show.video import picture

    counts = []
    with open_recording(CROSSING) as recording:
        for models in (None, folder):
            use_models(models)
            try:
                data = picture(recording, at=12, follow=100, size=(320, 180))
            except RecapError as error:
                pytest.skip(str(error))
            pixels = np.asarray(image.open(io.BytesIO(data)).convert("RGB")).astype(int)
            counts.append(int((np.minimum(pixels[..., 0], pixels[..., 2]) - pixels[..., 1] > 80).sum()))
    assert counts[0] < 5
    assert counts[1] > 300


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("vehicle.tesla.model3.glb", CAR[:-50], "is cut"),
        ("vehicle.a\x1b[31m\n.glb", boxes(({}, (1, 2, 3), (1, 2, 3))), "the model has no size"),
        ("vehicle.a\x1b[31m\n.glb", glb({"extensionsRequired": ["\x1b[31m"]}), "requires the extension"),
        ("car.glb", CAR, "the name of a blueprint was expected"),
        ("model.txt", CAR, "no models are in this folder"),
    ],
)
def test_a_folder_that_cannot_be_used_is_an_error_of_one_line(tmp_path, name, content, why):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecapError, match=why) as caught:
        use_models(tmp_path)
    assert str(caught.value).isprintable()
    assert str(tmp_path) in str(caught.value)


def test_all_models_of_a_folder_have_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("carla_recap.scene.models.MOST_TRIANGLES", 40)
    for name in ("vehicle.a.b.glb", "vehicle.a.c.glb"):
        (tmp_path / name).write_bytes(CAR)
    with pytest.raises(RecapError, match="more than 40 triangles"):
        use_models(tmp_path)


def test_textures_are_said_to_be_ignored(tmp_path):
    (tmp_path / "vehicle.a.b.glb").write_bytes(glb(*square(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})))
    with pytest.warns(RecapWarning, match="vehicle.a.b.glb: the textures are not shown"):
        use_models(tmp_path)
    use_models(None)


def test_the_command_ends_before_it_writes(tmp_path):
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "vehicle.audi.tt.glb").write_bytes(b"glTF")
    assert "vehicle.audi.tt.glb" in error("snapshot", CROSSING, tmp_path / "out.png", "--models", tmp_path / "models")
    assert names_in(tmp_path) == ["models"]
