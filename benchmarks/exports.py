"""Exports, as whole commands with their start-up; the incident page is timed by a browser."""

from __future__ import annotations

import shutil
from functools import partial
from typing import TYPE_CHECKING, Final

from benchmarks.hour import DIRECTORY
from benchmarks.measuring import COMMAND, Line, Missing, Subject, best, medians, run

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MINUTE: Final = 60.0  # s
CHROMIUM: Final = ("--headless=new", "--no-sandbox", "--window-size=1280,800")
FIRST_FRAME: Final = "return performance.getEntriesByName('recap-first-frame').map(mark => mark.startTime)[0]"


def rerun(subject: Subject) -> Iterator[Line]:
    target = DIRECTORY / "hour.rrd"
    taken = best(partial(run, COMMAND, "export", "--force", subject.mcap, target), times=2)
    size = target.stat().st_size / 1e6
    target.unlink()
    what, factor = f"{subject.length} to .rrd", subject.seconds / taken.seconds
    limit = max(10 * subject.seconds / 3600, 2)
    yield Line(what, f"{taken.seconds:.1f} s", f"{factor:,.0f} x real time", f"≤ {limit:.0f} s", taken.seconds <= limit)
    yield Line(f"{what}, peak memory", f"{taken.peak / 1e6:.0f} MB", "", "≤ 400 MB", taken.peak <= 400e6)
    yield Line(f"{what}, size", f"{size:.0f} MB", "", "≤ 390 MB", size <= 390)


def foxglove(subject: Subject) -> Iterator[Line]:
    target = DIRECTORY / "foxglove.mcap"
    seconds = min(subject.seconds / 2, 10 * MINUTE)
    taken = best(partial(run, COMMAND, "export", "--force", subject.mcap, target, "--duration", str(seconds)), times=2)
    factor = seconds / taken.seconds
    ratio = f"{factor:.0f} x real time"
    yield Line(f"{seconds:,.0f} s to Foxglove", f"{taken.seconds:.1f} s", ratio, "≥ 400 x", factor >= 400)


def parquet(subject: Subject) -> Iterator[Line]:
    folder = DIRECTORY / "parquet"
    limit = max(10 * subject.seconds / 3600, 2)
    for suffix, path in subject.both:
        taken = best(partial(run, COMMAND, "export", "--force", path, folder, "--to", "parquet"), times=2)
        size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
        shutil.rmtree(folder)
        what, factor = f"{subject.length} of {suffix} to Parquet", subject.seconds / taken.seconds
        yield Line(what, f"{taken.seconds:.1f} s", f"{factor:,.0f} x real time", f"≤ {limit:.0f} s", taken.seconds <= limit)
        files = f"{size:.0f} MB of files"
        yield Line(f"{what}, peak memory", f"{taken.peak / 1e6:.0f} MB", files, "≤ 400 MB", taken.peak <= 400e6)


def minute(subject: Subject) -> Iterator[Line]:
    from carla_recap import export_rerun
    from carla_recap.recording import open_recording

    mcap = subject.mcap
    middle = subject.seconds / 2
    window = ("--start", str(middle), "--duration", str(MINUTE))
    clip = best(partial(run, COMMAND, "clip", "--force", mcap, DIRECTORY / "minute.mcap", *window)).seconds

    def export() -> None:
        with open_recording(mcap) as recording:
            export_rerun(recording, DIRECTORY / "minute.rrd", start=middle, duration=MINUTE, force=True)

    (exporting,) = medians(export, times=3)  # in process: importing Rerun takes longer than that
    for what, seconds in (("clip of 60 s", clip), ("60 s to .rrd, in process", exporting)):
        yield Line(what, f"{seconds:.2f} s", f"{MINUTE / seconds:,.0f} x real time", "< 1 s", seconds < 1)


def snapshot(subject: Subject) -> Iterator[Line]:
    mcap = subject.mcap
    target = DIRECTORY / "snapshot.png"
    taken = best(partial(run, COMMAND, "snapshot", "--force", mcap, target, "--at", str(subject.seconds / 2)))
    yield Line("snapshot", f"{taken.seconds:.1f} s", "", "< 3 s", taken.seconds < 3)


def video(subject: Subject) -> Iterator[Line]:
    target = DIRECTORY / "video.mp4"
    window = ("--start", str(subject.seconds / 2), "--duration", "10")
    taken = best(partial(run, COMMAND, "video", "--force", subject.mcap, target, *window), times=2)
    size = target.stat().st_size / 1e6
    what = "video of 10 s, 1280 x 720 at 30 fps"
    yield Line(what, f"{taken.seconds:.1f} s", f"{size:.1f} MB of file", "≤ 20 s", taken.seconds <= 20)


def page(subject: Subject) -> Iterator[Line]:
    if shutil.which("chromedriver") is None:
        raise Missing("chromedriver")
    mcap = subject.mcap
    clip, file = DIRECTORY / "minute.mcap", DIRECTORY / "page.html"
    run(COMMAND, "clip", "--force", mcap, clip, "--start", str(subject.seconds / 2), "--duration", str(MINUTE))
    taken = run(COMMAND, "report", "--force", clip, file)
    size = file.stat().st_size / 1e6
    yield Line(
        "incident page of 60 s, as one file", f"{taken.seconds:.2f} s", f"{size:.2f} MB of file", "< 1.5 MB", size < 1.5
    )
    seconds = min(first_frame(file) for _ in range(3))
    yield Line("its first frame in Chromium", f"{seconds:.2f} s", "", "< 3 s", seconds < 3)


def first_frame(index: Path) -> float:
    """Return the seconds until the replay of a page has drawn its first frame."""
    from selenium import webdriver
    from selenium.webdriver.support.ui import WebDriverWait

    options = webdriver.ChromeOptions()
    for argument in CHROMIUM:
        options.add_argument(argument)
    driver = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        driver.get(index.resolve().as_uri())
        milliseconds: float = WebDriverWait(driver, 60).until(lambda _: driver.execute_script(FIRST_FRAME))
        return milliseconds / 1e3
    finally:
        driver.quit()


ROWS: Final = (rerun, foxglove, parquet, minute, snapshot, video, page)
