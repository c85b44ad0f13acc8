"""Recordings of the driving simulator CARLA, without the simulator: read, convert, query, replay, show, write.

import carla_recap

with carla_recap.open_recording("crash.log") as recording:
    print(recording.info)
    print(recording.collisions())
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from carla_recap.util.lazy import lazily

if TYPE_CHECKING:
    __version__: str

    from carla_recap.editing.author import Recorder, create_recording
    from carla_recap.editing.clip import clip
    from carla_recap.editing.convert import convert
    from carla_recap.editing.import_tracks import import_tracks
    from carla_recap.editing.recover import Recovery, recover
    from carla_recap.errors import (
        Closed,
        FormatError,
        MissingExtra,
        NoCredentials,
        NotARecording,
        NotSetUp,
        RecapError,
        RecapWarning,
        RecordError,
    )
    from carla_recap.exports import Exported, export
    from carla_recap.files.openscenario import export_openscenario
    from carla_recap.files.osi import export_osi
    from carla_recap.files.parquet import export_parquet
    from carla_recap.files.tracks import export_csv
    from carla_recap.fleet.conditions.facts import Finding, Offence
    from carla_recap.fleet.datasets import ExportedDataset, export_dataset
    from carla_recap.fleet.engine import map_recordings, open_recordings
    from carla_recap.fleet.index.database import RecordingIndex, open_index
    from carla_recap.fleet.index.writing import IndexSummary, write_index
    from carla_recap.fleet.outcomes import Outcome
    from carla_recap.fleet.rules import Rule, RuleSet, Verdict, check, load_rules
    from carla_recap.fleet.scores import score
    from carla_recap.fleet.sources import SourceFile
    from carla_recap.formats import create_writer
    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame, Header
    from carla_recap.model.lives import ActorLife
    from carla_recap.model.records import ActorKind, Attribute, Spawn, attributes
    from carla_recap.queries.blocked import BlockedRow
    from carla_recap.queries.collisions import CollisionRow
    from carla_recap.queries.differences import ActorDifference, Differences, EventDifference, LightDifference
    from carla_recap.queries.incidents import Incident, IncidentOptions
    from carla_recap.queries.info import InfoRow
    from carla_recap.queries.measures.definitions import MeasureRow, MeasureSeries
    from carla_recap.queries.score import Infraction, Route, Score, ScoreOptions, read_routes
    from carla_recap.queries.sensors import RecordedSensor
    from carla_recap.queries.summary import HeroSummary, RecordingSummary
    from carla_recap.recording import Recording, RecordingInfo, open_recording
    from carla_recap.replay import Player, Scene
    from carla_recap.roads import RoadMap, load_map
    from carla_recap.scene.models import use_models
    from carla_recap.sensors.options import SensingOptions
    from carla_recap.sensors.rig import SensorRig, SensorSpec
    from carla_recap.sensors.sensing import Sample, SensedFrame, sense
    from carla_recap.show.clips import clips
    from carla_recap.show.foxglove import export_foxglove
    from carla_recap.show.foxglove.sensed import export_sensed
    from carla_recap.show.page import write_report
    from carla_recap.show.rrd import export_rerun
    from carla_recap.show.video import export_video, picture, snapshot
    from carla_recap.tables.records import RecordTable
    from carla_recap.tables.trajectories import Controls, LightStates, Trajectories, Trajectory

__all__ = [
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

# The command line prints its help without importing numpy.
_get, __dir__ = lazily(
    __name__,
    {
        "model.batch": ("Batch",),
        "editing.author": ("Recorder", "create_recording"),
        "editing.clip": ("clip",),
        "editing.convert": ("convert",),
        "editing.import_tracks": ("import_tracks",),
        "exports": ("Exported", "export"),
        "files.openscenario": ("export_openscenario",),
        "files.osi": ("export_osi",),
        "files.tracks": ("export_csv",),
        "errors": (
            "Closed",
            "FormatError",
            "MissingExtra",
            "NoCredentials",
            "NotARecording",
            "NotSetUp",
            "RecapError",
            "RecapWarning",
            "RecordError",
        ),
        "scene.models": ("use_models",),
        "sensors.options": ("SensingOptions",),
        "sensors.rig": ("SensorRig", "SensorSpec"),
        "sensors.sensing": ("Sample", "SensedFrame", "sense"),
        "show.clips": ("clips",),
        "show.foxglove": ("export_foxglove",),
        "show.foxglove.sensed": ("export_sensed",),
        "show.page": ("write_report",),
        "show.rrd": ("export_rerun",),
        "show.video": ("export_video", "picture", "snapshot"),
        "files.parquet": ("export_parquet",),
        "fleet.conditions.facts": ("Finding", "Offence"),
        "fleet.rules": ("Rule", "RuleSet", "Verdict", "check", "load_rules"),
        "fleet.datasets": ("ExportedDataset", "export_dataset"),
        "fleet.outcomes": ("Outcome",),
        "fleet.engine": ("map_recordings", "open_recordings"),
        "fleet.scores": ("score",),
        "fleet.sources": ("SourceFile",),
        "model.frame": ("Frame", "Header"),
        "roads": ("RoadMap", "load_map"),
        "model.lives": ("ActorLife",),
        "queries.blocked": ("BlockedRow",),
        "queries.collisions": ("CollisionRow",),
        "queries.differences": ("ActorDifference", "Differences", "EventDifference", "LightDifference"),
        "fleet.index.database": ("RecordingIndex", "open_index"),
        "fleet.index.writing": ("IndexSummary", "write_index"),
        "formats": ("create_writer",),
        "queries.incidents": ("Incident", "IncidentOptions"),
        "queries.measures.definitions": ("MeasureRow", "MeasureSeries"),
        "queries.info": ("InfoRow",),
        "queries.score": ("Infraction", "Route", "Score", "ScoreOptions", "read_routes"),
        "queries.sensors": ("RecordedSensor",),
        "queries.summary": ("HeroSummary", "RecordingSummary"),
        "model.records": ("ActorKind", "Attribute", "Spawn", "attributes"),
        "recording": ("Recording", "RecordingInfo", "open_recording"),
        "editing.recover": ("Recovery", "recover"),
        "replay": ("Player", "Scene"),
        "tables.records": ("RecordTable",),
        "tables.trajectories": ("Controls", "LightStates", "Trajectories", "Trajectory"),
    },
)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("carla-recap")
    return _get(name)
