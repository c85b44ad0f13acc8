"""The process that draws."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import CancelledError
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.rendering import process as process_module
from carla_recap.rendering.camera import DrawnView
from carla_recap.rendering.process import RenderProcess, RenderProcessNotStarted
from carla_recap.util.child import ChildEnded
from tests.rendering.shapes import ALL, MODELS, PLANE, RGB, boxes, camera, create
from tests.waiting import PATIENCE, wait_until

BOXES = boxes((10, 0, 2), (15, 4, 1))


@pytest.fixture(scope="module")
def process(driver: None) -> Iterator[RenderProcess]:
    with RenderProcess(PLANE, models=MODELS) as process:
        yield process


def test_images_are_those_of_the_renderer(process: RenderProcess) -> None:
    before, hidden = (camera((-1, 0, 2)), BOXES), frozenset((0x1234,))
    images = process.draw(DrawnView(camera(), tuple(ALL), before, hidden), BOXES)
    with create() as renderer:
        expected = renderer.draw(camera(), BOXES, ALL, None, before, without=hidden)
    assert list(images) == list(expected)
    assert all((images[kind] == expected[kind]).all() for kind in ALL)


def test_a_town_that_cannot_be_made_is_an_error_and_leaves_no_process() -> None:
    def fail() -> None:
        started.update(set(psutil.Process().children()) - others)
        raise RecapError("no lane")

    started: set[psutil.Process] = set()
    others = set(psutil.Process().children())
    with pytest.raises(RecapError, match="no lane"):
        RenderProcess(fail, models=())
    assert started
    assert psutil.wait_procs(started, timeout=PATIENCE)[1] == []


def test_pictures_of_several_sizes_come_in_their_order(process: RenderProcess) -> None:
    sizes = [(width, 40) for width in (16, 900, 33, 500)]
    order: list[int] = []
    futures = [process.submit([DrawnView(replace(camera(), width=width, height=height))], BOXES) for width, height in sizes]
    for width, future in zip(sizes, futures, strict=True):
        future.add_done_callback(lambda _, width=width[0]: order.append(width))
    assert [future.result(PATIENCE)[0][RGB].shape[1::-1] for future in futures] == sizes
    process.draw(DrawnView(camera()), BOXES)
    assert order == [width for width, _ in sizes]


def test_what_cannot_be_drawn_is_an_error_of_that_picture_alone(process: RenderProcess) -> None:
    with pytest.raises(RecapError, match="100000 x 10 pixels"):
        process.draw(DrawnView(replace(camera(), width=100_000, height=10)))
    broken = replace(BOXES, ids=np.zeros(7, np.uint32))
    with pytest.raises(RecapError, match="the request has failed"):
        process.draw(DrawnView(camera(), without=frozenset((3,))), broken)
    assert process.draw(DrawnView(camera()), BOXES)[RGB].any()


def test_of_pictures_that_are_sent_only_the_first_fails_if_the_process_dies(driver: None) -> None:
    with RenderProcess(PLANE, models=MODELS) as process:
        assert process.pid is not None
        os.kill(process.pid, signal.SIGSTOP)
        first, second = (process.submit([DrawnView(replace(camera(), width=width))], BOXES) for width in (32, 64))
        wait_until(lambda: first.running() and second.running())
        os.kill(process.pid, signal.SIGKILL)
        with pytest.raises(ChildEnded, match="exit code -9"):
            first.result(PATIENCE)
        assert second.result(PATIENCE)[0][RGB].any()


def test_pauses_between_restarts_in_vain_grow(driver: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        starts.append(now)
        raise ChildEnded("killed")

    now, starts = 100.0, list[float]()
    monkeypatch.setattr(process_module, "monotonic", lambda: now)
    with RenderProcess(None, models=MODELS) as process:
        assert process.pid is not None
        os.kill(process.pid, signal.SIGKILL)
        with pytest.raises(ChildEnded, match="exit code -9"):
            process.draw(DrawnView(camera()), BOXES)
        monkeypatch.setattr(process, "_start", fail)
        while now < 300.0:
            with pytest.raises(RenderProcessNotStarted):
                process.draw(DrawnView(camera()), BOXES)
            now += 0.5
    assert np.diff(starts).tolist() == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]


def test_closing_ends_the_process_and_cancels_what_is_not_drawn(driver: None) -> None:
    process = RenderProcess(PLANE, models=MODELS)
    pid = process.pid
    assert pid is not None
    futures = [process.submit([DrawnView(replace(camera(), width=1600, height=1200))], BOXES) for _ in range(20)]
    process.close()
    process.close()
    with pytest.raises(CancelledError):
        futures[-1].result(PATIENCE)
    assert all(future.done() for future in futures)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(RecapError, match="closed"):
        process.draw(DrawnView(camera()))


def test_missing_moderngl_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "moderngl.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(MissingExtra, match=r"cameras"):
        RenderProcess(None, models=())


def test_a_missing_driver_names_the_packages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    failure = "def create_context(**_): raise Exception('libEGL.so.1 not loaded')"
    (tmp_path / "moderngl.py").write_text(failure)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(RecapError, match=r"libegl1 and libgl1-mesa-dri \(libEGL.so.1 not loaded\)") as raised:
        RenderProcess(None, models=())
    assert "\n" not in str(raised.value)
