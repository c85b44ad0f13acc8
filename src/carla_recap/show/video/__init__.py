"""Videos and pictures of recordings, drawn by the software renderer, without a GPU and without a display."""

from __future__ import annotations

from carla_recap.show.video.picture import picture, snapshot
from carla_recap.show.video.video import VideoInfo, export_video

__all__ = ["VideoInfo", "export_video", "picture", "snapshot"]
