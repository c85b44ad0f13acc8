"""A browser for pages."""

from tests.show.page.conftest import chromium

__all__ = ["chromium"]
