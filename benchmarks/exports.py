"""Exports, as whole commands with their start-up; the incident page is timed by a browser."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any, Final

from benchmarks.hour import DIRECTORY
from benchmarks.measuring import Line, Missing, Subject, at_least, at_most, line, medians, memory_line, recap

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MINUTE: Final = 60.0  # s
CHROMIUM: Final = ("--headless=new", "--no-sandbox", "--window-size=1280,800")
FIRST_FRAME: Final = "return performance.getEntriesByName('recap-first-frame').map(mark => mark.startTime)[0]"


def rerun(subject: Subject) -> Iterator[Line]:
    target = DIRECTORY / "hour.rrd"
    what = f"{subject.length} to .rrd"
    yield from _export(what, subject, subject.mcap, target)
    yield line(f"{what}, size", at_most(target.stat().st_size / 1e6, "{:.0f} MB", 390))
    target.unlink()


def foxglove(subject: Subject) -> Iterator[Line]:
    seconds = min(subject.seconds / 2, 10 * MINUTE)
    taken = recap("export", "--force", subject.mcap, DIRECTORY / "foxglove.mcap", "--duration", seconds, times=2).seconds
    yield line(f"{seconds:,.0f} s to Foxglove", f"{taken:.1f} s", at_least(seconds / taken, "{:.0f} x real time", 400))


def parquet(subject: Subject) -> Iterator[Line]:
    folder = DIRECTORY / "parquet"
    for suffix, path in subject.both:
        yield from _export(f"{subject.length} of {suffix} to Parquet", subject, path, folder, "--to", "parquet")
        shutil.rmtree(folder)


def minute(subject: Subject) -> Iterator[Line]:
    from carla_recap import export_rerun, open_recording

    mcap = subject.mcap

    def export() -> None:
        with open_recording(mcap) as recording:
            export_rerun(recording, DIRECTORY / "minute.rrd", start=subject.seconds / 2, duration=MINUTE, force=True)

    clip = recap("clip", "--force", mcap, DIRECTORY / "minute.mcap", *_middle(subject, MINUTE), times=3).seconds
    (exporting,) = medians(export, times=3)  # in process: importing Rerun takes longer than that
    for what, seconds in (("clip of 60 s", clip), ("60 s to .rrd, in process", exporting)):
        yield line(what, at_most(seconds, "{:.2f} s", 1), f"{MINUTE / seconds:,.0f} x real time")


def snapshot(subject: Subject) -> Iterator[Line]:
    arguments = subject.mcap, DIRECTORY / "snapshot.png", "--at", subject.seconds / 2
    yield line("snapshot", at_most(recap("snapshot", "--force", *arguments, times=3).seconds, "{:.1f} s", 3))


def video(subject: Subject) -> Iterator[Line]:
    target = DIRECTORY / "video.mp4"
    seconds = recap("video", "--force", subject.mcap, target, *_middle(subject, 10), times=2).seconds
    size = f"{target.stat().st_size / 1e6:.1f} MB of file"
    yield line("video of 10 s, 1280 x 720 at 30 fps", at_most(seconds, "{:.1f} s", 20), size)


def page(subject: Subject) -> Iterator[Line]:
    if shutil.which("chromedriver") is None:
        raise Missing("chromedriver")
    clip, file = DIRECTORY / "minute.mcap", DIRECTORY / "page.html"
    recap("clip", "--force", subject.mcap, clip, *_middle(subject, MINUTE))
    seconds = recap("report", "--force", clip, file).seconds
    size = at_most(file.stat().st_size / 1e6, "{:.2f} MB of file", 1.5)
    yield line("incident page of 60 s, as one file", f"{seconds:.2f} s", size)
    yield line("its first frame in Chromium", at_most(min(first_frame(file) for _ in range(3)), "{:.2f} s", 3))


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


def _middle(subject: Subject, seconds: float) -> tuple[Any, ...]:
    """Return the options for a part from the middle on."""
    return "--start", subject.seconds / 2, "--duration", seconds


def _export(what: str, subject: Subject, source: Path, target: Path, *options: str) -> Iterator[Line]:
    taken = recap("export", "--force", source, target, *options, times=2)
    seconds = at_most(taken.seconds, "{:.1f} s", max(10 * subject.hours, 2))
    yield line(what, seconds, f"{subject.seconds / taken.seconds:,.0f} x real time")
    files = f"{sum(file.stat().st_size for file in target.iterdir()) / 1e6:.0f} MB of files" if target.is_dir() else ""
    yield memory_line(what, taken.peak, 400, files)
