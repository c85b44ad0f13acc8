"""ScenarioRunner's metrics without a server: its log of a recording, and metric files as their authors wrote them.

from carla_recap.metrics import MetricsLog

log = MetricsLog("run.log")
hero = log.get_ego_vehicle_id()
print(log.get_actor_velocity(hero, frame=1))
"""

from __future__ import annotations

from carla_recap.util.lazy import lazily

__getattr__, __dir__, __all__ = lazily(__name__)
