"""The incident page: a summary, a list of incidents with pictures, and a replay from above, without a simulator.

with carla_recap.open_recording("crash.log") as recording:
    write_report(recording, "crash")
serve("crash")
"""

from __future__ import annotations

from carla_recap.show.page.report import Opening, Pictures, Report, write_report
from carla_recap.show.page.server import page_server, serve

__all__ = ["Opening", "Pictures", "Report", "page_server", "serve", "write_report"]
