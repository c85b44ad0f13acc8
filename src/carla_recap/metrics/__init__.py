"""ScenarioRunner's metrics without a server: its log of a recording, and metric files as their authors wrote them.

from carla_recap.metrics import MetricsLog

log = MetricsLog("run.log")
hero = log.get_ego_vehicle_id()
print(log.get_actor_velocity(hero, frame=1))
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    from carla_recap.metrics.log import MetricsLog
    from carla_recap.metrics.running import BasicMetric, run_metric

__all__ = ["BasicMetric", "MetricsLog", "run_metric"]

__getattr__, __dir__ = lazily(__name__, {"log": ("MetricsLog",), "running": ("BasicMetric", "run_metric")})
