"""Prints what nuscenes-devkit reads of a dataset, as JSON; run in an environment that has it."""

from __future__ import annotations

import json
import sys

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.data_classes import LidarPointCloud, RadarPointCloud
from nuscenes.utils.geometry_utils import points_in_box, transform_matrix, view_points
from nuscenes.utils.splits import get_scenes_of_custom_split
from pyquaternion import Quaternion


def main(folder: str, version: str, camera: str, lidar: str, radar: str) -> None:
    reader = NuScenes(version=version, dataroot=folder, verbose=False)
    samples = []
    for sample in reader.sample:
        path, boxes, matrix = reader.get_sample_data(sample["data"][camera])
        points, boxes_of_lidar, _ = reader.get_sample_data(sample["data"][lidar])
        cloud = LidarPointCloud.from_file(points)
        echoes = RadarPointCloud.from_file(reader.get_sample_data_path(sample["data"][radar]))
        to_camera = np.linalg.inv(to_world(reader, sample["data"][camera])) @ to_world(reader, sample["data"][lidar])
        found = {}
        for box, same in zip(boxes, boxes_of_lidar, strict=True):
            corners = view_points(box.corners(), matrix, normalize=True)[:2]
            hit = cloud.points[:3, points_in_box(same, cloud.points[:3], 1.005)]
            row = reader.get("sample_annotation", box.token)
            found[box.token] = {
                "category": box.name,
                "center": box.center.tolist(),
                "low": corners.min(axis=1).tolist(),
                "high": corners.max(axis=1).tolist(),
                "hits": (to_camera @ np.vstack((hit, np.ones(hit.shape[1]))))[:3].T.tolist(),
                "center_of_lidar": same.center.tolist(),
                "size": box.wlh.tolist(),
                "points": row["num_lidar_pts"],
                "echoes": row["num_radar_pts"],
                "visibility": row["visibility_token"],
                "speed": np.linalg.norm(reader.box_velocity(box.token)).item(),
            }
        samples.append({"image": path, "boxes": list(found.values()), "echoes": echoes.points.shape[1]})
    scenes = {split: get_scenes_of_custom_split(split, reader) for split in ("train", "val", "test")}
    print(json.dumps({"samples": samples, "scenes": scenes}))


def to_world(reader: NuScenes, token: str) -> np.ndarray:
    """Return the matrix from the axes of a sensor to the world at a sample, as its tables have it."""
    data = reader.get("sample_data", token)
    found = np.eye(4)
    for table in ("ego_pose", "calibrated_sensor"):
        row = reader.get(table, data[f"{table}_token"])
        found = found @ transform_matrix(row["translation"], Quaternion(row["rotation"]))
    return found


if __name__ == "__main__":
    main(*sys.argv[1:])
