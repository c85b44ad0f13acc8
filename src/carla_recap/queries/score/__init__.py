"""Scores of recordings, as CARLA's Leaderboard scores drives along routes."""

from __future__ import annotations

from carla_recap.util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(__name__)
