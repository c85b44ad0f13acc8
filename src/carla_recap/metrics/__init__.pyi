from carla_recap.metrics.log import MetricsLog as MetricsLog
from carla_recap.metrics.running import BasicMetric as BasicMetric
from carla_recap.metrics.running import run_metric as run_metric
