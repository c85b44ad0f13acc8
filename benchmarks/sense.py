"""What a rig sees of a recording: images, points, and all sensors of the Leaderboard with their messages."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmarks.hour import DIRECTORY
from benchmarks.measuring import COMMAND, Line, Subject, in_new_process, run, timed
from benchmarks.server import connect, per_second
from carla_recap.server import running

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.rendering.camera import Quality
    from carla_recap.sensors.rig import SensorRig

RECORDING: Final = Path("samples/crash.mcap")
LEADERBOARD: Final = Path("samples/rigs/leaderboard.json")
RIG: Final = Path("samples/rigs/front_camera.json")
START: Final = 7.0  # s: the hero drives from then on
IMAGES: Final = 60
FIRST: Final = 10  # moments that are left out: shaders are compiled, and images are drawn ahead
SECONDS: Final = 8.0
BEGINNING: Final = 10.0  # s after which a client that has spawned its sensors listens to them
CAMERA: Final[dict[str, Any]] = {"x": 1.5, "y": 0.0, "z": 1.6, "width": 800, "height": 600, "fov": 100}
FOUR: Final = ("rgb", "depth", "semantic_segmentation", "instance_segmentation")


def sense(_: Subject) -> Iterator[Line]:
    times = {}
    goals: tuple[tuple[Quality, float], ...] = (("epic", 35), ("low", 80))
    for quality, goal in goals:
        one = times[quality, 1] = _each(cameras(FOUR[:1]), quality)
        times[quality, 4] = _each(cameras(FOUR), quality)
        yield Line(
            f"RGB, 800 x 600, {quality}", f"{1 / one:.0f} a second", f"{one * 1e3:.0f} ms", f"≥ {goal} /s", 1 / one >= goal
        )
    ratio = times["epic", 4] / times["epic", 1]
    each = times["epic", 4]
    yield Line("RGB, depth, semantic, instance", f"{1 / each:.0f} a second", f"{ratio:.1f} x RGB", "≤ 1.5 x", ratio <= 1.5)
    yield from lidars()
    yield from leaderboard()


def cameras(kinds: tuple[str, ...], **size: int) -> SensorRig:
    """Return a rig of cameras in one place."""
    from carla_recap.sensors.rig import SensorRig

    return SensorRig.of([{"type": f"sensor.camera.{kind}", "id": kind, **CAMERA, **size} for kind in kinds])


def _each(rig: SensorRig, quality: Quality) -> float:
    """Return the seconds in which a moment is sensed."""
    from carla_recap import open_recording
    from carla_recap import sense as sense_recording

    with open_recording(RECORDING) as recording:
        frames = sense_recording(recording, rig, start=START, quality=quality)
        list(islice(frames, FIRST))
        seconds = timed(lambda: list(islice(frames, IMAGES))) / IMAGES
        frames.close()  # type: ignore[attr-defined]
    return seconds


def lidars() -> Iterator[Line]:
    """The points of a lidar in relation to its rays alone."""
    from carla_recap.sensors.rig import SensorRig

    rig = SensorRig.of([{"type": "sensor.lidar.ray_cast", "id": "top", "x": 0.0, "y": 0.0, "z": 2.4}], leaderboard=True)
    each, alone = (min(measure(rig) for _ in range(3)) for measure in (partial(_each, quality="low"), _rays_alone))
    what = f"{each * 1e3:.0f} ms a sweep"
    yield Line("lidar, 64 channels, 600,000 /s", what, f"{each / alone:.1f} x the rays", "≤ 2 x", each <= 2 * alone)


def _rays_alone(rig: SensorRig) -> float:
    """Return the seconds in which the rays of a moment are cast, of a rig of a lidar that is called `top`."""
    from carla_recap import open_recording
    from carla_recap import sense as sense_recording
    from carla_recap.rendering.rays import RayScene
    from carla_recap.replay.pose import LOCATION, MIRROR, rotations
    from carla_recap.scene.actor_instances import described_instances
    from carla_recap.scene.models import MODELS
    from carla_recap.sensors.beams import LidarBeams
    from carla_recap.town.mesh import load_town_of

    with open_recording(RECORDING) as recording:
        town = load_town_of(recording)
        assert town is not None
        scene, beams = RayScene(town.tiles, MODELS), LidarBeams(rig["top"].number, print)
        calls = []
        for frame in islice(sense_recording(recording, rig, start=START), IMAGES):
            pose = frame.samples["top"].pose
            rays = beams.rays(0.05) @ (MIRROR[:, None] * rotations(pose).T)
            instances = described_instances(frame.description, marks=False)
            others = instances.take(instances.ids != frame.carrier)
            calls.append(partial(scene.cast, pose[LOCATION], rays, beams.reach, others))
    return sum(timed(call) for call in calls[FIRST:]) / (IMAGES - FIRST)


def leaderboard() -> Iterator[Line]:
    """The rig of the Leaderboard at 10 Hz, with its messages."""
    from carla_recap import open_recording
    from carla_recap import sense as sense_recording
    from carla_recap.sensors.messages import SensorMessages
    from carla_recap.sensors.rig import SensorRig

    rig = SensorRig.load(LEADERBOARD, leaderboard=True)
    sizes: list[int] = []
    with open_recording(RECORDING) as recording:
        maker = SensorMessages(rig, recording.header)
        frames = sense_recording(recording, rig, start=START, duration=SECONDS, rate=10.0)

        def work() -> None:
            for _, messages in maker.encoded(frames):
                sizes.append(sum(len(message.data) for message in messages))

        seconds = timed(work)
    share, size = seconds / SECONDS, np.mean(sizes) / 1e3
    yield Line(
        "Leaderboard rig, 10 Hz, messages included", f"{size:.0f} kB each", f"{share:.2f} x the time", "≤ 1 x", share <= 1
    )


def sense_memory(subject: Subject) -> Iterator[Line]:
    """The memory of `sense` for all of a recording, and for a sixth of it, with few and small images."""
    from carla_recap.sensors.rig import SensorRig

    rig, target, peaks = DIRECTORY / "small.json", DIRECTORY / "sensed.mcap", []
    sensors = [*cameras(FOUR[:2], width=64, height=48), *SensorRig.load(LEADERBOARD, leaderboard=True)]
    kept = [sensor.to_dict() for sensor in sensors if sensor.image is None or sensor.id in FOUR]
    rig.write_text(json.dumps(kept))
    for seconds in (subject.seconds / 6, subject.seconds):
        options = "--rig", rig, "--rate", "1", "--quality", "low", "--duration", str(seconds), "--force"
        peaks.append(run(COMMAND, "sense", subject.mcap, target, *options).peak / 1e6)
    growth = f"{peaks[1] - peaks[0]:+.0f} MB to a sixth"
    yield Line(f"memory of sense, {subject.length}", f"{peaks[1]:.0f} MB", growth, "≤ 600 MB", peaks[1] <= 600)


def capture_ticks(_subject: Subject) -> Iterator[Line]:
    """The server's ticks with `capture --rig` beside it, in relation to the same client that listens and does not record."""
    most = {True: 0.0, False: 0.0}
    for _ in range(3):
        for records in most:
            with running(recordings=DIRECTORY) as port:
                most[records] = max(most[records], in_new_process(tick_rate_beside, port, records))
    ratio = most[False] / most[True]
    yield Line(
        "sync ticks with capture --rig", f"{most[True]:.0f} a second", f"{ratio:.2f} x listening", "≤ 1.1 x", ratio <= 1.1
    )


def tick_rate_beside(port: int, records: bool) -> float:
    """Return the ticks a second of a server with a hero, while a client has a rig on it, which it records or listens to."""
    import carla

    town = connect(port).get_world()
    town.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
    model = town.get_blueprint_library().find("vehicle.tesla.model3")
    model.set_attribute("role_name", "hero")
    town.spawn_actor(model, town.get_map().get_spawn_points()[0])
    command: list[str | Path] = [sys.executable, "-m", __name__, str(port)]
    if records:
        command = [COMMAND, "capture", DIRECTORY / "captured.mcap", "--rig", RIG, "--port", str(port), "--force"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as client:
        sensors = 0
        while sensors < len(json.loads(RIG.read_text())) and client.poll() is None:
            town.tick()
            sensors = len(town.get_actors().filter("sensor.*")) - len(town.get_actors().filter("*.collision"))
        deadline = time.monotonic() + BEGINNING
        while time.monotonic() < deadline:
            town.tick()
        rate = per_second(town.tick, 25)
        client.send_signal(signal.SIGINT)
        while client.poll() is None:
            town.tick()
    town.apply_settings(carla.WorldSettings())
    return rate


def listen(port: int) -> None:
    """Spawn a rig on the hero and listen to it, until Ctrl-C."""
    from carla_recap.capture.observer import Observer
    from carla_recap.capture.rig import RigSensors
    from carla_recap.sensors.rig import SensorRig

    with (
        Observer("127.0.0.1", port, additional_data=False, attach=True) as observer,
        observer.until_signal(),
        RigSensors(observer, SensorRig.load(RIG)) as sensors,
    ):
        sensors.listen(lambda frame: None)
        for _ in observer.observations():
            pass


ROWS: Final = (sense, sense_memory, capture_ticks)

if __name__ == "__main__":
    listen(int(sys.argv[1]))
