"""A browser without a window; tests are skipped where it is not installed."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest

from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from selenium.webdriver import Chrome


@contextmanager
def browser(*arguments: str) -> Iterator[Chrome]:
    """Yield a browser with some options of its command line."""
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not binary or not driver:
        pytest.skip("chromium or chromedriver is not installed")
    webdriver = pytest.importorskip("selenium.webdriver")
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for argument in ("headless=new", "no-sandbox", "disable-background-networking", "window-size=1440,900", *arguments):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    chrome.set_script_timeout(PATIENCE)
    chrome.set_page_load_timeout(PATIENCE)
    try:
        yield chrome
    finally:
        chrome.quit()


@pytest.fixture(scope="session")
def shared_browser() -> Iterator[Chrome]:
    """A browser for all tests."""
    with browser("disable-gpu") as chrome:
        yield chrome


@pytest.fixture
def chromium(shared_browser: Chrome) -> Iterator[Chrome]:
    """The browser for all tests; it keeps no page, which would go on playing beside the tests after it."""
    yield shared_browser
    shared_browser.get("about:blank")
