"""Pages in a browser."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from tests.waiting import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from selenium.webdriver import Chrome


class Page:
    """An open page."""

    def __init__(self, browser: Chrome, path: Path, link: str = "") -> None:
        self.browser = browser
        browser.get("about:blank")
        browser.get_log("browser")
        browser.get((path if path.is_file() else path / "index.html").as_uri() + link)
        self.until(lambda: self.ask("performance.getEntriesByName('recap-first-frame').length") == 1)

    def ask(self, expression: str, *arguments: Any) -> Any:
        return self.browser.execute_script(f"return {expression}", *arguments)

    def until(self, condition: Callable[[], bool]) -> None:
        wait_until(condition)

    def click(self, selector: str, index: int = 0) -> None:
        self.browser.execute_script("document.querySelectorAll(arguments[0])[arguments[1]].click()", selector, index)

    def press(self, *keys: str) -> None:
        from selenium.webdriver import ActionChains

        for key in keys:
            ActionChains(self.browser).send_keys(key).perform()

    def text(self, id: str) -> str:
        return self.ask("document.getElementById(arguments[0]).textContent", id)

    @property
    def time(self) -> float:
        return self.ask("replay.clock.time")

    @property
    def pictures(self) -> int:
        """The number of pictures that have been drawn."""
        return self.ask("[...document.images].filter(image => image.naturalWidth === 480).length")

    @property
    def errors(self) -> list[Any]:
        return self.browser.get_log("browser")


@contextmanager
def emulated(
    browser: Chrome, *, size: tuple[int, int] | None = None, media: str = "", scheme: str = "dark"
) -> Iterator[None]:
    """Emulate a screen, print, and a preferred colour scheme."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})
    if size:
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": True}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        yield
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.execute_script("try { localStorage.clear() } catch {}")
