"""Camera path files of nerfstudio's viewer, which ``ns-render camera-path`` reads.

The file has one entry for each image, with a camera-to-world matrix whose camera axes are those of OpenGL (x right, y
up, z backwards), a vertical field of view in degrees, and, for scenes that move, a time from 0 to 1. It also has the
key frames from which the viewer has made the images, and to which it returns when it loads the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from fourd.base.json_file import Finite, decode_json
from fourd.viewer.camera_paths.keys import MAX_IMAGES, KeyedPath, KeyFrame, evenly_spaced
from fourd.viewer.camera_paths.path import CameraPath, PathLens
from fourd.viewer.camera_paths.scene import PathScene
from fourd.viewer.camera_paths.world import World, opengl_matrix, opengl_pose
from fourd.viewer.navigation.pose import Pose
from fourd.viewer.navigation.recorded_path import RECORDED_FPS, PathSample

Array = NDArray[np.float64]

DEFAULT_TRANSITION_S = 2.0
"""Time between two key frames, if the file does not state it. nerfstudio's viewer suggests this value."""
_MAX_KEYS = 32
"""Maximum number of key frames that are written."""
_LENSES: dict[str, PathLens] = {
    "perspective": "pinhole",
    "fisheye": "fisheye",
    "omnidirectional": "panorama",  # a stereo panorama, for which the user adds --stereo
    "equirectangular": "panorama",
}

_Matrix = Annotated[tuple[Finite, ...], Meta(min_length=16, max_length=16)]
_Degrees = Annotated[float, Meta(gt=0, lt=180)]
_Pixels = Annotated[float, Meta(ge=1, le=16384)]


@dataclass(frozen=True)
class _Image:
    camera_to_world: _Matrix
    fov: _Degrees = 50.0
    render_time: Finite | None = None


@dataclass(frozen=True)
class _Key:
    matrix: _Matrix
    fov: _Degrees = 50.0
    render_time: Finite | None = None
    override_transition_enabled: bool | None = None
    override_transition_sec: Annotated[float, Meta(ge=0, le=86400)] | None = None


@dataclass(frozen=True)
class _Head:
    """The values of the file that describe all images."""

    render_height: _Pixels | None = None
    render_width: _Pixels | None = None
    camera_type: Literal["perspective", "fisheye", "omnidirectional", "equirectangular"] = "perspective"
    fps: Annotated[float, Meta(gt=0, le=1000)] | None = None
    seconds: Annotated[float, Meta(ge=0, le=86400)] | None = None
    is_cycle: bool = False
    default_transition_sec: Annotated[float, Meta(gt=0, le=86400)] = DEFAULT_TRANSITION_S


@dataclass(frozen=True)
class _Images:
    camera_path: Annotated[tuple[_Image, ...], Meta(max_length=MAX_IMAGES)] = ()


@dataclass(frozen=True)
class _Keys:
    keyframes: Annotated[tuple[_Key, ...], Meta(min_length=1, max_length=10_000)]


def is_nerfstudio(content: Any) -> bool:
    """Return whether parsed JSON is a camera path of nerfstudio."""
    return isinstance(content, dict) and ("camera_path" in content or "keyframes" in content)


def from_nerfstudio(content: Any, scene: PathScene, world: World) -> CameraPath:
    """Convert the parsed JSON of a camera path.

    The images are those of the file, in the same order. A file that has only key frames is interpolated as fourd's own
    paths are. Raises ValueError for other content.
    """
    head = decode_json(content, _Head)
    images = decode_json(content, _Images).camera_path
    if not images:
        path = _from_keys(head, decode_json(content, _Keys).keyframes, scene, world)
    else:
        has_frames = all(image.render_time is not None for image in images)
        focus = _focus(scene, world)
        samples = []
        for index, image in enumerate(images):
            pose = _pose(f"camera_path[{index}], camera_to_world", image.camera_to_world, image.fov, focus)
            frame = scene.frame_at(image.render_time) if has_frames and image.render_time is not None else 0.0
            samples.append(PathSample(world.apply(pose), round(frame)))
        fps = len(samples) / head.seconds if head.seconds else head.fps or RECORDED_FPS
        path = CameraPath(tuple(samples), min(fps, 1000.0), has_frames, head.is_cycle)
    has_size = head.render_width is not None and head.render_height is not None
    size = (round(head.render_width or 0), round(head.render_height or 0)) if has_size else None
    notes = ("crop: not used",) if content.get("crop") is not None else ()
    return CameraPath(
        path.samples, path.fps, path.has_frames, path.is_loop, size, _LENSES[head.camera_type], notes, path.curve
    )


def to_nerfstudio(path: CameraPath, size: tuple[int, int], scene: PathScene, world: World) -> dict[str, Any]:
    """Convert a path to the JSON that nerfstudio reads. Some of its images are stored as key frames, which nerfstudio's
    viewer loads. ``size`` is width and height of the images in pixels."""
    aspect, duration = size[0] / size[1], len(path.samples) / path.fps
    outward = world.inverse()
    keys = KeyedPath(evenly_spaced(path.samples, path.fps, _MAX_KEYS), path.fps, duration if path.is_loop else None)
    default_fov = float(np.degrees(keys.keys[0].pose.field_of_view))
    times = [0.0 if key.frame is None else scene.time_of(key.frame) for key in keys.keys]
    stored = []
    for key, time, transition in zip(keys.keys, times, _transitions(keys), strict=True):
        entry = {
            "matrix": opengl_matrix(outward.apply(key.pose)).ravel().tolist(),
            "fov": float(np.degrees(key.pose.field_of_view)),
            "aspect": aspect,
            "override_transition_enabled": transition is not None,
            "override_transition_sec": transition,
        }
        stored.append({**entry, "render_time": time, "override_time_enabled": True} if path.has_frames else entry)
    images = []
    for sample in path.samples:
        image: dict[str, Any] = {
            "camera_to_world": opengl_matrix(outward.apply(sample.pose)).ravel().tolist(),
            "fov": float(np.degrees(sample.pose.field_of_view)),
            "aspect": aspect,
        }
        images.append({**image, "render_time": scene.time_of(sample.frame)} if path.has_frames else image)
    return {
        "default_fov": default_fov,
        **({"default_time": times[0]} if path.has_frames else {}),
        "default_transition_sec": DEFAULT_TRANSITION_S,
        "keyframes": stored,
        "camera_type": {lens: name for name, lens in _LENSES.items()}[path.lens],
        "render_height": size[1],
        "render_width": size[0],
        "fps": path.fps,
        "seconds": duration,
        "is_cycle": path.is_loop,
        "smoothness_value": 0.0,
        "camera_path": images,
    }


def _from_keys(head: _Head, stored: Sequence[_Key], scene: PathScene, world: World) -> CameraPath:
    focus, keys, seconds = _focus(scene, world), [], 0.0
    for index, key in enumerate(stored):
        seconds += _transition(key, head) if index > 0 else 0.0
        pose = _pose(f"keyframes[{index}], matrix", key.matrix, key.fov, focus)
        frame = None if key.render_time is None else scene.frame_at(key.render_time)
        keys.append(KeyFrame(world.apply(pose), seconds, frame))
    loop = seconds + _transition(stored[0], head) if head.is_cycle else None
    return KeyedPath(tuple(keys), head.fps or RECORDED_FPS, loop).path()


def _transition(key: _Key, head: _Head) -> float:
    """Return the seconds from the key frame before ``key`` to ``key``."""
    own = key.override_transition_sec if key.override_transition_enabled else None
    return head.default_transition_sec if own is None else own


def _transitions(path: KeyedPath) -> list[float | None]:
    """Return, for each key frame, the seconds since the one before it. Those of the first one lead back to it."""
    times = [key.seconds for key in path.keys]
    first = None if path.loop_seconds is None else path.loop_seconds - times[-1]
    return [first, *(after - before for before, after in pairwise(times))]


def _pose(where: str, matrix: Sequence[float], degrees: float, focus: Array | None) -> Pose:
    try:
        return opengl_pose(np.reshape(matrix, (4, 4)), float(np.radians(degrees)), focus)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _focus(scene: PathScene, world: World) -> Array:
    """Return the focus of the scene in the world of the file."""
    back = world.inverse()
    return back.scale * back.rotation @ scene.focus + back.shift
