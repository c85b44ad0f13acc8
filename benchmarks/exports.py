"""What is measured of exports: whole commands, start-up included, but for the page, which a browser times."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benchmarks.hour import DIRECTORY
from benchmarks.rows import Line, Run, Subject, medians, run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

COMMAND: Final = Path(sys.executable).with_name("carla-recap")
MINUTE: Final = 60.0  # s
BOOT: Final = ("--headless=new", "--no-sandbox", "--window-size=1280,800")
FIRST_FRAME: Final = "return performance.getEntriesByName('recap-first-frame').map(mark => mark.startTime)[0]"


def rerun(subject: Subject) -> Iterator[Line]:
    *_, (_, mcap) = subject.both()
    target = DIRECTORY / "hour.rrd"
    whole = best(lambda: run(COMMAND, "export", "--force", mcap, target), times=2)
    size = target.stat().st_size / 1e6
    target.unlink()
    what = f"{subject.seconds:,.0f} s to .rrd"
    factor = f"{subject.seconds / whole.seconds:,.0f} x real time"
    yield Line(what, f"{whole.seconds:.1f} s", factor, "≤ 10 s", whole.seconds <= 10)
    yield Line(f"{what}, peak memory", f"{whole.peak / 1e6:.0f} MB", "", "≤ 400 MB", whole.peak <= 400e6)
    yield Line(f"{what}, size", f"{size:.0f} MB", "", "≤ 460 MB", size <= 460)


def minute(subject: Subject) -> Iterator[Line]:
    from carla_recap.export.rerun import export_rerun
    from carla_recap.recording import open_recording

    *_, (_, mcap) = subject.both()
    middle = subject.seconds / 2
    window = ("--start", str(middle), "--duration", str(MINUTE))
    cutting = best(lambda: run(COMMAND, "clip", "--force", mcap, DIRECTORY / "minute.mcap", *window)).seconds

    def export() -> None:
        with open_recording(mcap) as recording:
            export_rerun(recording, DIRECTORY / "minute.rrd", start=middle, duration=MINUTE, force=True)

    (exporting,) = medians(export, times=3)  # to import Rerun takes longer than that
    for what, seconds in (("clip of 60 s", cutting), ("60 s to .rrd, in process", exporting)):
        yield Line(what, f"{seconds:.2f} s", f"{MINUTE / seconds:,.0f} x real time", "< 1 s", seconds < 1)


def foxglove(subject: Subject) -> Iterator[Line]:
    *_, (_, mcap) = subject.both()
    target = DIRECTORY / "foxglove.mcap"
    seconds = min(subject.seconds / 2, 10 * MINUTE)
    taken = best(lambda: run(COMMAND, "export", "--force", mcap, target, "--duration", str(seconds)), times=2)
    factor = seconds / taken.seconds
    yield Line(
        f"{seconds:,.0f} s to Foxglove", f"{taken.seconds:.1f} s", f"{factor:.0f} x real time", "≥ 400 x", factor >= 400
    )


def parquet(subject: Subject) -> Iterator[Line]:
    folder = DIRECTORY / "parquet"
    for suffix, path in subject.both():
        whole = best(lambda path=path: run(COMMAND, "export", "--force", path, folder, "--to", "parquet"), times=2)
        size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
        shutil.rmtree(folder)
        what = f"{subject.seconds:,.0f} s of {suffix} to Parquet"
        factor = f"{subject.seconds / whole.seconds:,.0f} x real time"
        yield Line(what, f"{whole.seconds:.1f} s", factor, "≤ 10 s", whole.seconds <= 10)
        yield Line(
            f"{what}, peak memory", f"{whole.peak / 1e6:.0f} MB", f"{size:.0f} MB of files", "≤ 400 MB", whole.peak <= 400e6
        )


def snapshot(subject: Subject) -> Iterator[Line]:
    *_, (_, mcap) = subject.both()
    target = DIRECTORY / "moment.png"
    taken = best(lambda: run(COMMAND, "snapshot", "--force", mcap, target, "--at", str(subject.seconds / 2)))
    yield Line("snapshot", f"{taken.seconds:.1f} s", "", "< 20 s", taken.seconds < 20)


def page(subject: Subject) -> Iterator[Line]:
    *_, (_, mcap) = subject.both()
    clip, folder = DIRECTORY / "minute.mcap", DIRECTORY / "page"
    run(COMMAND, "clip", "--force", mcap, clip, "--start", str(subject.seconds / 2), "--duration", str(MINUTE))
    shutil.rmtree(folder, ignore_errors=True)
    taken = run(COMMAND, "report", clip, folder)
    yield Line("incident page of 60 s", f"{taken.seconds:.2f} s", "", "", True)
    seconds = min(first_frame(folder / "index.html") for _ in range(3))
    yield Line("its first frame in Chromium", f"{seconds:.2f} s", "", "< 3 s", seconds < 3)


def first_frame(index: Path) -> float:
    """Seconds until the replay of a page has drawn its first frame."""
    from selenium import webdriver
    from selenium.webdriver.support.ui import WebDriverWait

    options = webdriver.ChromeOptions()
    for argument in BOOT:
        options.add_argument(argument)
    driver = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        driver.get(index.resolve().as_uri())
        milliseconds: float = WebDriverWait(driver, 60).until(lambda _: driver.execute_script(FIRST_FRAME))
        return milliseconds / 1e3
    finally:
        driver.quit()


def best(work: Callable[[], Run], times: int = 3) -> Run:
    """The fastest of some runs, with the highest peak of any."""
    runs = [work() for _ in range(times)]
    return Run(min(each.seconds for each in runs), max(each.peak for each in runs))


ROWS: Final = (rerun, minute, foxglove, parquet, snapshot, page)
