"""Commands that are killed again and again, at random moments: nothing that is wrong may be under a final name.

`python -m benchmarks.kills --kills 300 --only convert` kills one of them 300 times.
"""

from __future__ import annotations

import argparse
import random
import shutil
import subprocess
import sys
import time
import warnings
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from benchmarks.campaign import make
from benchmarks.fleet import contents
from benchmarks.measuring import COMMAND
from carla_recap import RecapError, RecapWarning, open_recording, recover
from carla_recap.editing.convert import convert as run_convert
from carla_recap.fleet.index.tables import TABLES
from carla_recap.server import running

if TYPE_CHECKING:
    from collections.abc import Callable

SAMPLES: Final = Path(__file__).parents[1] / "samples"
EARLIEST, LATEST = 0.35, 1.0  # of the time that a command takes, at which it is killed
ROUND: Final = 5  # kills, after which a command that goes on ends once
GONE: Final = 20.0  # s for the child processes of a killed command to end


@dataclass
class Killed:
    """A command that is killed.

    Attributes:
        command: The command.
        folder: What it writes is in here.
        check: Is called with the folder after each kill, and returns what is wrong.
        goes_on: Whether the next command goes on with what is there; else the folder is emptied.
        at_end: Is called with the folder when such a command has ended, and returns what is wrong.
        codes: The exit codes of a command that ends.
        seconds: The time that it takes, in s.
        seen: What became of it, and how often.
    """

    command: tuple[Any, ...]
    folder: Path
    check: Callable[[Path], list[str]]
    goes_on: bool = False
    at_end: Callable[[Path], list[str]] = lambda _: []
    codes: tuple[int, ...] = (0,)
    seconds: float = 0.0
    seen: Counter[str] = field(default_factory=Counter)

    def kill(self, count: int, rng: random.Random) -> list[str]:
        """Kill the command many times; return what is wrong."""
        self.seconds = self._run()
        wrong = self.at_end(self.folder)
        self._clear()
        for number in range(count):
            wrong += self._killed(rng.uniform(EARLIEST, LATEST) * self.seconds, rng)
            wrong += self.check(self.folder)
            if self.goes_on and number % ROUND == ROUND - 1:
                self._run()
                wrong += self.at_end(self.folder)
                self._clear()
            elif not self.goes_on:
                self._clear()
        return wrong

    def _run(self) -> float:
        begin = time.perf_counter()
        done = subprocess.run(list(map(str, self.command)), capture_output=True, text=True, check=False)
        if done.returncode not in self.codes:
            raise SystemExit(done.stderr)
        return time.perf_counter() - begin

    def _killed(self, seconds: float, rng: random.Random) -> list[str]:
        """Run the command, and kill it after some seconds, or all its processes; return which of them do not end then."""
        import psutil

        with subprocess.Popen(list(map(str, self.command)), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            try:
                begin = time.perf_counter()
                process.wait(seconds)
                self.seen["ended before"] += 1
                self.seconds = time.perf_counter() - begin
                return []
            except subprocess.TimeoutExpired:
                pass
            children: list[Any] = []
            with suppress(psutil.NoSuchProcess):
                children = psutil.Process(process.pid).children(recursive=True)
            process.kill()
            if rng.random() < 0.5:
                for child in children:
                    with suppress(psutil.NoSuchProcess):
                        child.kill()
        self.seen["killed"] += 1
        _, alive = psutil.wait_procs(children, GONE)
        return [f"the process {each.pid} goes on" for each in alive]

    def _clear(self) -> None:
        shutil.rmtree(self.folder)
        self.folder.mkdir()


def _recording(frames: int | None, content: bytes | None, is_live: bool, killed: Killed, folder: Path) -> list[str]:
    """Check a folder with one recording, or with what is left of it, which `recover` takes."""
    path, wrong = folder / killed.command[-1], []
    for each in folder.iterdir():
        if not each.name.startswith(".") and each.suffix in (".mcap", ".log"):
            killed.seen["under its name"] += 1
            if content is not None and not (content.startswith(_as_log(each)) if is_live else content == each.read_bytes()):
                wrong.append(f"{each.name}: other frames")
            with warnings.catch_warnings(), open_recording(each) as recording:
                warnings.simplefilter("error", RecapWarning)
                if not recording.info.frames:
                    wrong.append(f"{each.name}: no frames")
        elif each.name.endswith(".partial"):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", RecapWarning)
                    found = recover(each, folder / f"recovered{path.suffix}", force=True)
            except RecapError:
                killed.seen["too early to recover"] += 1
                continue
            killed.seen["recovered"] += 1
            if frames is not None and found.frames > frames:
                wrong.append(f"{found.frames} of {frames} frames are recovered")
            (folder / f"recovered{path.suffix}").unlink()
        elif each.suffix != ".json":
            wrong.append(f"{each.name} is left")
    return wrong


def _as_log(path: Path) -> bytes:
    """Return a recording as CARLA's log, whose beginning is that of a recording that ended earlier."""
    if path.suffix == ".log":
        return path.read_bytes()
    with TemporaryDirectory() as folder:
        run_convert(path, Path(folder, "out.log"))
        return Path(folder, "out.log").read_bytes()


def _one(work: Path, *arguments: Any, name: str = "out.mcap", is_repeatable: bool = True, is_live: bool = False) -> Killed:
    """Return a command that writes a recording."""
    folder = work / "out"
    folder.mkdir()
    command = (COMMAND, *arguments, folder / name)
    frames = content = None
    if is_repeatable:
        subprocess.run(list(map(str, command)), check=True, capture_output=True)
        content = _as_log(folder / name) if is_live else (folder / name).read_bytes()
        with open_recording(folder / name) as recording:
            frames = recording.info.frames
        shutil.rmtree(folder)
        folder.mkdir()
    killed = Killed(command, folder, lambda _: [])
    killed.check = partial(_recording, frames, content, is_live, killed)
    return killed


def convert(work: Path, _: ExitStack) -> Killed:
    source = work / "source.mcap"
    subprocess.run([COMMAND, "record", source, "--duration", "120", "--seed", "1", "-q"], check=True)
    return _one(work, "convert", source, name="out.log")


def record(work: Path, _: ExitStack) -> Killed:
    return _one(work, "record", "--vehicles", 10, "--walkers", 5, "--duration", 30, "--seed", 1, is_live=True)


RIG: Final = """[
{"id": "front", "type": "sensor.camera.rgb", "x": 1, "y": 0, "z": 2, "width": 64, "height": 48, "fov": 90},
{"id": "lidar", "type": "sensor.lidar.ray_cast", "x": 0, "y": 0, "z": 2.4, "points_per_second": 20000}]
"""


def sense(work: Path, _: ExitStack) -> Killed:
    rig = work / "rig.json"
    rig.write_text(RIG)
    return _one(work, "sense", SAMPLES / "crash.mcap", "--rig", rig, "--start", 2, "--duration", 2)


def capture(work: Path, stack: ExitStack) -> Killed:
    port = stack.enter_context(running())
    return _one(work, "capture", "--port", port, "--duration", 2, is_repeatable=False)


def index(work: Path, _: ExitStack) -> Killed:
    runs, folder, expected = work / "runs", work / "out", work / "expected.duckdb"
    folder.mkdir()
    make(runs, 16, 2)
    command = (COMMAND, "index", "--measures", "--jobs", 2, runs)
    subprocess.run([*map(str, command), expected], check=False, capture_output=True)
    whole = contents(expected)

    def check(folder: Path, *, is_complete: bool = False) -> list[str]:
        path = folder / "index.duckdb"
        if not path.exists():
            return []
        found = contents(path)
        others = [f"{name} has {row[:300]}" for name in TABLES for row in set(found[name]) - set(whole[name])]
        if is_complete:
            others += [f"{name} lacks {row[:300]}" for name in TABLES for row in set(whole[name]) - set(found[name])]
            others += [f"{name} has rows twice" for name in TABLES if len(found[name]) > len(whole[name])]
        return others

    return Killed((*command, folder / "index.duckdb"), folder, check, True, partial(check, is_complete=True), (0, 2))


def campaign(work: Path, _: ExitStack) -> Killed:
    folder, expected = work / "out", work / "expected"
    folder.mkdir()
    function = f"{SAMPLES / 'campaign.py'}:follow"
    command = (
        COMMAND,
        "campaign",
        function,
        "--seeds",
        "1:4",
        "--param",
        "seconds=2",
        "--workers",
        2,
        "--pages",
        0,
        "--out",
    )
    subprocess.run([*map(str, command), expected], check=True, capture_output=True)

    def check(folder: Path, *, is_complete: bool = False) -> list[str]:
        there = {path.name: path for path in folder.glob("*.mcap")}
        wrong = [
            f"{name}: other bytes" for name, path in there.items() if path.read_bytes() != (expected / name).read_bytes()
        ]
        if is_complete:
            left = sorted({path.name for path in folder.iterdir()} ^ {path.name for path in expected.iterdir()})
            wrong += [f"{name}: is left, or lacks" for name in left]
        return wrong

    return Killed((*command, folder), folder, check, True, partial(check, is_complete=True))


COMMANDS: Final = {each.__name__: each for each in (convert, record, sense, index, campaign, capture)}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=20, help="of each command (default: %(default)s)")
    parser.add_argument("--only", action="append", choices=COMMANDS, metavar="NAME")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    failed = False
    for name in options.only or COMMANDS:
        begin = time.monotonic()
        with TemporaryDirectory(prefix="kills-") as work, ExitStack() as stack:
            killed = COMMANDS[name](Path(work), stack)
            wrong = Counter(killed.kill(options.kills, random.Random(options.seed)))
        counts = ", ".join(f"{count} {what}" for what, count in killed.seen.items())
        print(f"{name}: {counts}; {wrong.total()} wrong; {time.monotonic() - begin:.0f} s", flush=True)
        for what, count in wrong.most_common(10):
            print(f"    {count} x {what}", flush=True)
        failed |= bool(wrong)
    sys.exit(failed)


if __name__ == "__main__":
    main()
