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
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import psutil

from benchmarks.campaign import CRASH, SAMPLES, make
from benchmarks.measuring import COMMAND, recap
from carla_recap import RecapError, RecapWarning, convert, open_recording, recover
from carla_recap.fleet.index.tables import TABLES
from carla_recap.server import running
from tests.fleet.indexes import contents

if TYPE_CHECKING:
    from collections.abc import Callable

    Check = Callable[[Path, bool], list[str]]

EARLIEST, LATEST = 0.35, 1.0  # of the time that a command takes, at which it is killed
ROUND: Final = 5  # kills, after which a command that goes on ends once
GONE: Final = 20.0  # s for the child processes of a killed command to end
RIG: Final = """[
{"id": "front", "type": "sensor.camera.rgb", "x": 1, "y": 0, "z": 2, "width": 64, "height": 48, "fov": 90},
{"id": "lidar", "type": "sensor.lidar.ray_cast", "x": 0, "y": 0, "z": 2.4, "points_per_second": 20000}]
"""


@dataclass
class Killed:
    """A command that is killed.

    Attributes:
        command: The command, without the path that it writes, which comes last.
        path: That path, in a folder of its own or that folder.
        goes_on: Whether the next command goes on with what is there; else it is removed.
        codes: The exit codes of a command that ends.
        seen: What became of it, and how often.
    """

    command: tuple[Any, ...]
    path: Path
    goes_on: bool = False
    codes: tuple[int, ...] = (0,)
    seen: Counter[str] = field(default_factory=Counter)

    @property
    def folder(self) -> Path:
        return self.path.parent if self.path.suffix else self.path

    def complete(self) -> float:
        """Run the command to its end, and return its seconds."""
        self.folder.mkdir(exist_ok=True)
        return recap(*self.command, self.path, codes=self.codes).seconds

    def kill_often(self, check: Check, count: int, rng: random.Random) -> list[str]:
        """Kill the command many times; return what is wrong with what there is after each, or after its end."""
        seconds = self.complete()
        wrong = check(self.folder, True)
        self.clear()
        for number in range(count):
            wrong += self._killed(rng.uniform(EARLIEST, LATEST) * seconds, rng) + check(self.folder, False)
            if self.goes_on and number % ROUND == ROUND - 1:
                self.complete()
                wrong += check(self.folder, True)
            if not self.goes_on or number % ROUND == ROUND - 1:
                self.clear()
        return wrong

    def _killed(self, seconds: float, rng: random.Random) -> list[str]:
        """Run the command, and kill it after some seconds, or all its processes; return which of them do not end then."""
        command = list(map(str, (COMMAND, *self.command, self.path)))
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            with suppress(subprocess.TimeoutExpired):
                process.wait(seconds)
                self.seen["ended before"] += 1
                return []
            children: list[Any] = []
            with suppress(psutil.NoSuchProcess):
                children = psutil.Process(process.pid).children(recursive=True)
            process.kill()
            for child in children if rng.random() < 0.5 else ():
                with suppress(psutil.NoSuchProcess):
                    child.kill()
        self.seen["killed"] += 1
        _, alive = psutil.wait_procs(children, GONE)
        return [f"the process {each.pid} goes on" for each in alive]

    def clear(self) -> None:
        """Remove what there is."""
        shutil.rmtree(self.folder)
        self.folder.mkdir()


def recording(killed: Killed, *, is_repeatable: bool = True, is_live: bool = False) -> tuple[Killed, Check]:
    """Return a command that writes a recording, and what checks it, or what is left of it, which `recover` takes."""
    frames = content = None
    if is_repeatable:
        killed.complete()
        content = _as_log(killed.path) if is_live else killed.path.read_bytes()
        with open_recording(killed.path) as whole:
            frames = whole.info.frames
        killed.clear()

    def check(folder: Path, is_complete: bool) -> list[str]:
        wrong, recovered = [], folder / f"recovered{killed.path.suffix}"
        for each in folder.iterdir():
            if each.name.endswith(".partial"):
                try:
                    with warnings.catch_warnings(action="ignore", category=RecapWarning):
                        found = recover(each, recovered, force=True)
                except RecapError:
                    killed.seen["too early to recover"] += 1
                    continue
                killed.seen["recovered"] += 1
                if frames is not None and found.frames > frames:
                    wrong.append(f"{found.frames} of {frames} frames are recovered")
                recovered.unlink()
            elif each.suffix in (".mcap", ".log"):
                killed.seen["under its name"] += 1
                if content and not (content.startswith(_as_log(each)) if is_live else content == each.read_bytes()):
                    wrong.append(f"{each.name}: other frames")
                with warnings.catch_warnings(action="error", category=RecapWarning), open_recording(each) as opened:
                    if not opened.info.frames:
                        wrong.append(f"{each.name}: no frames")
            elif each.suffix != ".json":
                wrong.append(f"{each.name} is left")
        return wrong

    return killed, check


def _as_log(path: Path) -> bytes:
    """Return a recording as CARLA's log, whose beginning is that of a recording that ended earlier."""
    with TemporaryDirectory() as folder:
        convert(path, Path(folder, "out.log"))
        return Path(folder, "out.log").read_bytes()


def killed_convert(work: Path, _: ExitStack) -> tuple[Killed, Check]:
    recap("record", work / "source.mcap", "--duration", 120, "--seed", 1, "-q")
    return recording(Killed(("convert", work / "source.mcap"), work / "out" / "out.log"))


def killed_record(work: Path, _: ExitStack) -> tuple[Killed, Check]:
    command = "record", "--vehicles", 10, "--walkers", 5, "--duration", 30, "--seed", 1
    return recording(Killed(command, work / "out" / "out.mcap"), is_live=True)


def killed_sense(work: Path, _: ExitStack) -> tuple[Killed, Check]:
    rig = work / "rig.json"
    rig.write_text(RIG)
    command = "sense", CRASH, "--rig", rig, "--start", 2, "--duration", 2
    return recording(Killed(command, work / "out" / "out.mcap"))


def killed_capture(work: Path, stack: ExitStack) -> tuple[Killed, Check]:
    command = "capture", "--port", stack.enter_context(running()), "--duration", 2
    return recording(Killed(command, work / "out" / "out.mcap"), is_repeatable=False)


def killed_index(work: Path, _: ExitStack) -> tuple[Killed, Check]:
    make(work / "runs", 16, 2)
    command, expected = ("index", "--measures", "--jobs", 2, work / "runs"), work / "expected.duckdb"
    recap(*command, expected, codes=(2,))
    whole, killed = contents(expected), Killed(command, work / "out" / "index.duckdb", True, (2,))

    def check(folder: Path, is_complete: bool) -> list[str]:
        found = contents(killed.path) if killed.path.exists() else {name: [] for name in TABLES}
        wrong = [f"{name} has {row[:300]}" for name in TABLES for row in set(found[name]) - set(whole[name])]
        if is_complete:
            wrong += [f"{name} has other rows" for name in TABLES if found[name] != whole[name]]
        return wrong

    return killed, check


def killed_campaign(work: Path, _: ExitStack) -> tuple[Killed, Check]:
    function, expected = f"{SAMPLES / 'campaign.py'}:follow", work / "expected"
    runs = "--seeds", "1:4", "--param", "seconds=2", "--workers", 2, "--pages", 0
    command = "campaign", function, *runs, "--out"
    recap(*command, expected)

    def check(folder: Path, is_complete: bool) -> list[str]:
        there = {path.name: path for path in folder.glob("*.mcap")}
        wrong = [f"{name}: other bytes" for name in there if there[name].read_bytes() != (expected / name).read_bytes()]
        if is_complete:
            left = sorted({path.name for path in folder.iterdir()} ^ {path.name for path in expected.iterdir()})
            wrong += [f"{name}: is left, or lacks" for name in left]
        return wrong

    return Killed(command, work / "out", True), check


COMMANDS: Final = {
    "convert": killed_convert,
    "record": killed_record,
    "sense": killed_sense,
    "index": killed_index,
    "campaign": killed_campaign,
    "capture": killed_capture,
}


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
            killed, check = COMMANDS[name](Path(work), stack)
            wrong = Counter(killed.kill_often(check, options.kills, random.Random(options.seed)))
        counts = ", ".join(f"{count} {what}" for what, count in killed.seen.items())
        print(f"{name}: {counts}; {wrong.total()} wrong; {time.monotonic() - begin:.0f} s", flush=True)
        for what, count in wrong.most_common(10):
            print(f"    {count} x {what}", flush=True)
        failed |= bool(wrong)
    sys.exit(failed)


if __name__ == "__main__":
    main()
