"""The poses of ``transforms.json`` (nerfstudio, instant-ngp) as a camera path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fourd.base.errors import UserError
from fourd.recording.importing.formats.transforms_json import read_poses
from fourd.viewer.camera_paths.path import CameraPath
from fourd.viewer.camera_paths.scene import PathScene
from fourd.viewer.camera_paths.world import World, opengl_matrix
from fourd.viewer.navigation.pose import pose_from_camera
from fourd.viewer.navigation.recorded_path import PathSample


def is_transforms(content: Any) -> bool:
    """Return whether parsed JSON is a transforms.json."""
    return isinstance(content, dict) and isinstance(content.get("frames"), list)


def from_transforms(path: Path, content: Any, scene: PathScene, world: World) -> CameraPath:
    """Convert the parsed JSON of the file ``path``: one image for each entry, in the order of the file. The images
    themselves need not be there, if the file states their sizes. The images per second are those of the scene.

    Raises:
        UserError: if a value is missing or invalid.
    """
    entries = read_poses(path, content)
    timed = [time for _, time in entries if time is not None]
    if timed and (len(timed) < len(entries) or min(timed) < 0 or max(timed) > 1):
        raise UserError(
            f"{path}: expected a time from 0 to 1 in each entry or in none, got {len(timed)} times in {len(entries)} "
            f"entries, from {min(timed):g} to {max(timed):g}; remove them, or divide them by the duration"
        )
    samples, is_distorted = [], False
    back = world.inverse()
    focus = back.scale * back.rotation @ scene.focus + back.shift
    for camera, time in entries:
        pose = pose_from_camera(camera, focus, -camera.rotation[1], (camera.width, camera.height))
        samples.append(PathSample(world.apply(pose), 0 if time is None else round(scene.frame_at(time))))
        is_distorted |= camera.distortion is not None
    first = entries[0][0]
    notes = ("lens distortion: not used, images are those of pinhole cameras",) if is_distorted else ()
    return CameraPath(tuple(samples), scene.fps, bool(timed), size=(first.width, first.height), notes=notes)


def to_transforms(path: CameraPath, size: tuple[int, int], scene: PathScene, world: World) -> dict[str, Any]:
    """Convert a path to the content of a transforms.json, whose images are named as ``fourd render`` names them."""
    outward, frames = world.inverse(), []
    for index, sample in enumerate(path.samples):
        camera = sample.pose.camera(*size)
        entry = {
            "file_path": f"images/{index:06d}.png",
            "fl_x": float(camera.intrinsics[0, 0]),
            "fl_y": float(camera.intrinsics[1, 1]),
            "cx": float(camera.intrinsics[0, 2]),
            "cy": float(camera.intrinsics[1, 2]),
            "w": size[0],
            "h": size[1],
            "transform_matrix": np.round(opengl_matrix(outward.apply(sample.pose)), 12).tolist(),
        }
        frames.append({**entry, "time": scene.time_of(sample.frame)} if path.has_frames else entry)
    return {"camera_model": "PINHOLE", "frames": frames}
