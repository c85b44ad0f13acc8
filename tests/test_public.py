"""The public names of the package, and that importing it imports little."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest

import carla_recap
from tests.waiting import PATIENCE

NAMES = [
    "ActorDifference",
    "ActorKind",
    "ActorLife",
    "Attribute",
    "Batch",
    "BlockedRow",
    "Closed",
    "CollisionRow",
    "Controls",
    "Differences",
    "EventDifference",
    "Exported",
    "ExportedDataset",
    "Finding",
    "FormatError",
    "Frame",
    "Header",
    "HeroSummary",
    "Incident",
    "IncidentOptions",
    "IndexSummary",
    "InfoRow",
    "Infraction",
    "LightDifference",
    "LightStates",
    "MeasureRow",
    "MeasureSeries",
    "MissingExtra",
    "NoCredentials",
    "NotARecording",
    "NotSetUp",
    "Offence",
    "Outcome",
    "Player",
    "RecapError",
    "RecapWarning",
    "RecordError",
    "RecordTable",
    "RecordedSensor",
    "Recorder",
    "Recording",
    "RecordingIndex",
    "RecordingInfo",
    "RecordingSummary",
    "Recovery",
    "RoadMap",
    "Route",
    "Rule",
    "RuleSet",
    "Sample",
    "Scene",
    "Score",
    "ScoreOptions",
    "SensedFrame",
    "SensingOptions",
    "SensorRig",
    "SensorSpec",
    "SourceFile",
    "Spawn",
    "Trajectories",
    "Trajectory",
    "Verdict",
    "attributes",
    "check",
    "clip",
    "clips",
    "convert",
    "create_recording",
    "create_writer",
    "export",
    "export_csv",
    "export_dataset",
    "export_foxglove",
    "export_openscenario",
    "export_osi",
    "export_parquet",
    "export_rerun",
    "export_sensed",
    "export_video",
    "import_tracks",
    "load_map",
    "load_rules",
    "map_recordings",
    "open_index",
    "open_recording",
    "open_recordings",
    "picture",
    "read_routes",
    "recover",
    "score",
    "sense",
    "snapshot",
    "use_models",
    "write_index",
    "write_report",
]


def test_these_names_are_public():
    assert carla_recap.__all__ == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_exists_and_is_documented(name):
    assert name in dir(carla_recap)
    found = getattr(carla_recap, name)
    assert found.__name__ == name
    assert found.__doc__


def test_the_package_lists_its_public_names():
    assert [name for name in dir(carla_recap) if not name.startswith("_")] == sorted(NAMES)


def test_every_name_can_be_imported_at_once():
    found = {}
    exec("from carla_recap import *", found)
    assert set(NAMES) <= set(found)


def test_another_name_is_an_error():
    with pytest.raises(AttributeError, match="module 'carla_recap' has no attribute 'wings'"):
        carla_recap.wings  # noqa: B018


def test_the_version_is_that_of_the_package():
    assert carla_recap.__version__ == version("carla-recap")


@pytest.mark.parametrize("heavy", ["numpy", "mcap", "google.protobuf", "pandas", "zstandard"])
def test_importing_the_package_imports_nothing_heavy(heavy):
    code = f"import sys, carla_recap; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE).returncode == 0


def test_errors_have_one_base():
    for name in ("FormatError", "NotARecording", "RecordError", "MissingExtra", "NotSetUp"):
        assert issubclass(getattr(carla_recap, name), carla_recap.RecapError)
    assert issubclass(carla_recap.MissingExtra, carla_recap.NotSetUp)
    assert issubclass(carla_recap.NoCredentials, carla_recap.NotSetUp)
    assert issubclass(carla_recap.NotARecording, carla_recap.FormatError)
    assert issubclass(carla_recap.RecapWarning, UserWarning)
