"""Reads the manifest of a `.4dv` file. The file is untrusted: types, ranges and sizes are checked."""

from __future__ import annotations

import json
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.viewer.blender.addon.points import ImportProblem, View

MAX_MANIFEST = 64 << 20
MAX_FRAMES, MAX_VIEWS, MAX_POINTS, MAX_SIDE, MAX_STEPS = 1_000_000, 4096, 1 << 26, 1 << 16, 1 << 16
NEWEST_VERSION = 5
"""Scenes of version 5 have sound, which the add-on does not read. They are packed if they describe how."""
SH_NUMBERS = 48


@dataclass(frozen=True, eq=False)
class Encoding:
    """Quantisation of the points of a packed scene, with the names of docs/formats.md."""

    lower: NDArray[np.float64]
    position_step: float
    position_bits: int
    radius_lower: float
    radius_steps: int
    density_levels: int
    sh_basis: NDArray[np.float64]
    sh_mean: NDArray[np.float64]
    sh_step: float

    @property
    def code_bytes(self) -> int:
        """Number of bytes of the Morton code of a position."""
        return (3 * self.position_bits + 7) // 8


@dataclass(frozen=True, eq=False)
class Manifest:
    """What the add-on needs of a manifest.

    Attributes:
        path: the file.
        fps: frames per second.
        metres_per_unit: length of a world unit in metres, or None if it is not known.
        points: number of points of each frame.
        background_points: number of static points, 0 if there are none.
        source_count: number of source views.
        views: the source views, then the other cameras.
        sh_base, sh_range: the constants of the colour from spherical harmonics.
        dynamic, background: encodings of a packed scene, or None.
    """

    path: Path
    fps: float
    metres_per_unit: float | None
    points: tuple[int, ...]
    background_points: int
    source_count: int
    views: tuple[View, ...]
    sh_base: float
    sh_range: float
    dynamic: Encoding | None
    background: Encoding | None


def read_manifest(path: Path) -> Manifest:
    """Read the manifest of a scene. Raises ImportProblem."""
    try:
        with zipfile.ZipFile(path) as archive:
            size = archive.getinfo("manifest.json").file_size
            if size > MAX_MANIFEST:
                raise ImportProblem(f"{path}: expected a manifest of at most {MAX_MANIFEST} bytes, got {size}")
            content = archive.read("manifest.json")
    except (OSError, KeyError, zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, RuntimeError) as error:
        raise ImportProblem(f"{path}: expected a .4dv scene, got another or damaged file ({_line(error)})") from error
    try:
        return _parse(path, json.loads(content))
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise ImportProblem(f"{path}: expected a valid manifest, got a damaged one ({_line(error)})") from error


def _parse(path: Path, content: Any) -> Manifest:
    if content["format"] != "fourd-scene":
        raise ValueError("format is not fourd-scene")
    version = whole(content["version"], 1, 1 << 31)
    if version > NEWEST_VERSION:
        raise ImportProblem(
            f"{path}: expected a scene of version 1 to {NEWEST_VERSION}, got {version}; update the add-on"
        )
    source = [_view(each) for each in limited(content["source_views"], MAX_VIEWS)]
    other = [_view(each) for each in limited(content["other_views"], MAX_VIEWS)]
    points = tuple(whole(each["points"], 0, MAX_POINTS) for each in limited(content["frames"], MAX_FRAMES))
    if not points:
        raise ImportProblem(f"{path}: expected at least one frame, got none; export the scene again")
    is_packed = "encoding" in content if version == NEWEST_VERSION else version > 2
    encoding: Any = content["encoding"] if is_packed else None
    kept = encoding is not None and encoding.get("background") is not None
    background = content["background"]["points"] if content.get("kind") == "full" else 0
    metres = content.get("metres_per_unit")
    return Manifest(
        path,
        number(content.get("fps", 30.0), 1e-3, 1e4),
        None if metres is None else number(metres, 1e-9, 1e9),
        points,
        whole(background, 0, MAX_POINTS),
        len(source),
        (*source, *other),
        number(content["sh"]["base"], -1e3, 1e3),
        number(content["sh"]["range"], 0, 1e3),
        None if encoding is None else _encoding(encoding["dynamic"]),
        _encoding(encoding["background"]) if kept else None,
    )


def _view(content: Any) -> View:
    name = content["name"]
    if not isinstance(name, str) or len(name) > 255:
        raise ValueError("a camera has no name")
    width, height = (whole(content[side], 1, MAX_SIDE) for side in ("width", "height"))
    intrinsics, rotation = (numbers(content[key], (3, 3)) for key in ("intrinsics", "rotation"))
    if not (intrinsics[0, 0] > 0 and intrinsics[1, 1] > 0):
        raise ValueError(f"camera {name} has no focal length")
    return View(name, width, height, intrinsics, rotation, numbers(content["translation"], (3,)))


def _encoding(content: Any) -> Encoding:
    rows = whole(content["sh_rows"], 0, SH_NUMBERS)
    return Encoding(
        numbers(content["lower"], (3,)),
        number(content["position_step"], 1e-30, 1e30),
        whole(content["position_bits"], 1, 21),
        number(content["radius_lower"], 1e-30, 1e4),
        whole(content["radius_steps"], 1, MAX_STEPS),
        whole(content["density_levels"], 1, 255),
        numbers(content["sh_basis"], (rows * SH_NUMBERS,)).reshape(rows, SH_NUMBERS),
        numbers(content["sh_mean"], (SH_NUMBERS,)),
        number(content["sh_step"], 1e-9, 1e3),
    )


def limited(content: Any, count: int) -> list[Any]:
    """Return a list of at most ``count`` items. Raises ValueError."""
    if not isinstance(content, list) or len(content) > count:
        raise ValueError(f"expected a list of at most {count} items")
    return content


def whole(value: Any, low: int, high: int) -> int:
    """Return an integer from ``low`` to ``high``. Raises ValueError."""
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"expected an integer from {low} to {high}, got {str(value)[:40]}")
    return value


def number(value: Any, low: float, high: float) -> float:
    """Return a number from ``low`` to ``high``. Raises ValueError."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"expected a number from {low} to {high}, got {str(value)[:40]}")
    return float(value)


def numbers(content: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return finite numbers as an array of this shape. Raises ValueError."""
    if not isinstance(content, list) or len(content) > math.prod(shape):
        raise ValueError(f"expected {math.prod(shape)} numbers")
    values = np.array(content, dtype=np.float64)
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"expected finite numbers of the shape {shape}, got {values.shape}")
    return values


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
