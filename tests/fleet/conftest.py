"""A browser for pages."""

from tests.export.report.conftest import chromium

__all__ = ["chromium"]
