"""The images of a camera path through a scene: their cameras and frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from fourd.base.cameras import Camera, estimate_up
from fourd.base.errors import UserError
from fourd.viewer.camera_paths.path import CameraPath
from fourd.viewer.camera_paths.reading import read_path
from fourd.viewer.camera_paths.scene import PathScene
from fourd.viewer.camera_paths.world import SAME_WORLD, World
from fourd.viewer.navigation.paths import PathKind, camera_path
from fourd.viewer.navigation.pose import Pose, pose_from_camera
from fourd.viewer.navigation.recorded_path import PathSample

MIN_STEPS = 120
DEFAULT_SIZE = (1280, 720)


@dataclass(frozen=True)
class PathTiming:
    """How the scene and the camera move.

    Attributes:
        steps: number of images, or None for the number of the file, or for enough images to play the whole scene.
        speed: speed of the scene, above 0. If a path file states the frame of each image, the camera slows down too.
        is_ping_pong: whether the scene plays forwards and backwards in turn. A path file is followed to its end and
            back.
        frozen: index of the only frame that is shown, or None.
        frames: indices of the frames that are shown, or None for all.
    """

    steps: int | None = None
    speed: float = 1.0
    is_ping_pong: bool = False
    frozen: int | None = None
    frames: Sequence[int] | None = None


@dataclass(frozen=True, eq=False)
class PathPlan:
    """The images of a path.

    Attributes:
        cameras: the camera of each image.
        frames: index of the scene's frame that each image shows.
        fps: images per second, or None for the rate of the scene.
        path: the same images, with poses instead of cameras.
    """

    cameras: Sequence[Camera]
    frames: Sequence[int]
    fps: float | None
    path: CameraPath


def plan_path(
    name: str,
    scene: PathScene,
    timing: PathTiming,
    size: tuple[int, int] | None,
    *,
    world: World = SAME_WORLD,
    start: Pose | None = None,
    default_size: tuple[int, int] | None = None,
) -> PathPlan:
    """Return the images of the path that the option --path names.

    Args:
        name: a :data:`~fourd.viewer.navigation.paths.PathKind`, or a file that :func:`read_path` reads.
        size: width and height of the images in pixels, or None for those that the file states.
        world: relation of the world of nerfstudio's files to that of the capture.
        start: pose from which the paths around a scene without cameras start.
        default_size: width and height if neither ``size`` nor the file states them, or None for those of the first
            camera.

    Raises:
        UserError: if the file is not a path, or if it states what ``timing`` states too.
    """
    kinds: dict[str, PathKind] = {kind: kind for kind in get_args(PathKind)}
    if name in kinds:
        return _around(kinds[name], scene, timing, size or default_size, start)
    if not Path(name).exists():
        raise UserError(f"--path: expected {', '.join(kinds)} or a path file, got '{name}'; check the name")
    path = read_path(Path(name), scene, world)
    first = (scene.cameras[0].width, scene.cameras[0].height) if scene.cameras else DEFAULT_SIZE
    return _from_file(name, path, scene, timing, size or path.size or default_size or first)


def played_frames(
    count: int, frames: Sequence[int], rate: float, *, is_ping_pong: bool = False, frozen: int | None = None
) -> list[int]:
    """Return the frame of each of ``count`` images of a scene that plays in a loop, ``rate`` frames for each image."""
    if frozen is not None:
        return [frozen] * count
    # The small number is for rates such as 1 / 3, whose multiples are rounded down to less than a whole number.
    steps = np.floor(np.arange(count) * rate + 1e-6).astype(np.int64)
    if is_ping_pong and len(frames) > 1:
        period = 2 * (len(frames) - 1)
        steps = np.minimum(steps % period, period - steps % period)
    return [frames[step % len(frames)] for step in steps]


def _around(
    kind: PathKind, scene: PathScene, timing: PathTiming, size: tuple[int, int] | None, start: Pose | None
) -> PathPlan:
    frames = range(scene.frame_count) if timing.frames is None else timing.frames
    length = len(frames)
    if timing.frozen is not None:
        length = 1
    elif timing.is_ping_pong:
        length = max(1, 2 * (len(frames) - 1))
    steps = timing.steps or max(MIN_STEPS, round(length / timing.speed))
    if scene.cameras:
        cameras = camera_path(
            kind, scene.cameras, scene.focus, steps, size=size, is_whole=scene.is_whole, bounds=scene.bounds
        )
        up = estimate_up(scene.cameras)
        samples = [pose_from_camera(each, scene.focus, up, (each.width, each.height)) for each in cameras]
    else:
        if start is None:
            raise UserError("--path: expected a scene with cameras, got none; name a path file")
        samples = [start.orbit(2 * np.pi * step / steps, 0.0) for step in range(steps)]
        cameras = [pose.camera(*(size or DEFAULT_SIZE)) for pose in samples]
    shown = played_frames(steps, frames, timing.speed, is_ping_pong=timing.is_ping_pong, frozen=timing.frozen)
    images = tuple(PathSample(pose, frame) for pose, frame in zip(samples, shown, strict=True))
    return PathPlan(cameras, shown, None, CameraPath(images, scene.fps, scene.frame_count > 1, is_loop=True))


def _from_file(name: str, path: CameraPath, scene: PathScene, timing: PathTiming, size: tuple[int, int]) -> PathPlan:
    if path.has_frames and timing.frames is not None:
        raise UserError(f"--path {name}: expected no --frames, because the file says which frames are shown; omit it")
    is_slowed = path.has_frames and timing.frozen is None
    if is_slowed and timing.speed != 1 and timing.steps is not None:
        raise UserError("--speed, --steps: expected one of them, because the file has the frames of images, got both")
    count = timing.steps or max(1, round(len(path.samples) / (timing.speed if is_slowed else 1.0)))
    path = path.with_count(count)
    if timing.is_ping_pong:
        path = path.there_and_back()
    count = len(path.samples)
    last = scene.frame_count - 1
    if is_slowed:
        shown = [min(sample.frame, last) for sample in path.samples]
    else:
        frames = range(scene.frame_count) if timing.frames is None else timing.frames
        rate = timing.speed * scene.fps / path.fps
        shown = played_frames(count, frames, rate, is_ping_pong=timing.is_ping_pong, frozen=timing.frozen)
    cameras = [sample.pose.camera(*size) for sample in path.samples]
    samples = tuple(PathSample(sample.pose, frame) for sample, frame in zip(path.samples, shown, strict=True))
    return PathPlan(cameras, shown, path.fps, replace(path, samples=samples, has_frames=scene.frame_count > 1))
