"""The relation between the world of a path file and the world of the capture.

nerfstudio's parsers of data sets turn, move and scale the world of a capture, and its viewer and its path files use the
result. ``dataparser_transforms.json``, which it writes beside its checkpoints, has the relation to the world of the
original calibration. The programs that prepare nerfstudio's data sets also turn the world before, which the key
``applied_transform`` of ``transforms.json`` tells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.json_file import Finite, read_json_as
from fourd.viewer.navigation.pose import Pose

Array = NDArray[np.float64]

T = TypeVar("T")
Row = tuple[Finite, Finite, Finite, Finite]
_MAX_DEVIATION = 1e-2
"""Maximum difference between a rotation of a file and the nearest rotation matrix. Files store float32 values, and some
programs round them to a few digits."""


@dataclass(frozen=True, eq=False)
class World:
    """Maps world points of a path file to those of the capture: ``x_capture = rotation @ x_file * scale + shift``.

    Attributes:
        rotation: (3, 3) rotation matrix R_capture_file.
        scale: length in the capture's world of a unit of the file's world, above 0.
        shift: (3,) in units of the capture's world.
    """

    rotation: Array
    scale: float
    shift: Array

    def __matmul__(self, other: World) -> World:
        """Return the map that applies ``other`` first."""
        shift = self.scale * self.rotation @ other.shift + self.shift
        return World(self.rotation @ other.rotation, self.scale * other.scale, shift)

    def inverse(self) -> World:
        """Return the map in the other direction."""
        return World(self.rotation.T, 1 / self.scale, -self.rotation.T @ self.shift / self.scale)

    def apply(self, pose: Pose) -> Pose:
        """Return the pose in the other world."""
        return Pose(
            self.scale * self.rotation @ pose.pivot + self.shift,
            pose.rotation @ self.rotation.T,
            self.scale * pose.distance,
            pose.field_of_view,
            self.rotation @ pose.up,
            pose.offset,
        )


SAME_WORLD = World(np.eye(3), 1.0, np.zeros(3))
"""The relation if a path file uses the world of the capture."""


def read_world(paths: Sequence[Path]) -> World:
    """Read the relation of nerfstudio's world to the capture's.

    Args:
        paths: ``dataparser_transforms.json``. If the capture was imported from a ``transforms.json`` with the key
            ``applied_transform``, this file is the second path.

    Raises:
        UserError: if a file cannot be read, or if it has other content.
    """
    if not 1 <= len(paths) <= 2:
        raise UserError(
            f"--path-world: expected dataparser_transforms.json and optionally transforms.json, got {len(paths)} files"
        )
    parser = _read(paths[0], _DataParser)
    # nerfstudio maps x to scale * (R x + t).
    rotation, shift = _rigid(paths[0], "transform", parser.transform)
    world = World(rotation, parser.scale, parser.scale * shift).inverse()
    if len(paths) == 1:
        return world
    applied = _read(paths[1], _Applied)
    if applied.applied_transform is None:
        return world
    rotation, shift = _rigid(paths[1], "applied_transform", applied.applied_transform)
    return World(rotation, applied.applied_scale, applied.applied_scale * shift) @ world


def rigid_transform(values: Sequence[Sequence[float]] | Array) -> tuple[Array, Array]:
    """Split a matrix (3, 4) or (4, 4) into the rotation (3, 3) and the translation (3,). Raises ValueError if there is
    no rotation in it."""
    matrix = np.asarray(values, np.float64)
    left, scales, right = np.linalg.svd(matrix[:3, :3])
    if np.abs(scales - 1).max() > _MAX_DEVIATION or np.linalg.det(left @ right) < 0:
        raise ValueError(
            f"expected a rotation in the first three columns, got a matrix of determinant "
            f"{float(np.linalg.det(matrix[:3, :3])):.3g}"
        )
    return left @ right, matrix[:3, 3]


@dataclass(frozen=True)
class _DataParser:
    transform: tuple[Row, Row, Row]
    scale: Annotated[float, Meta(gt=1e-9, lt=1e9)]


@dataclass(frozen=True)
class _Applied:
    applied_transform: tuple[Row, Row, Row] | None = None
    applied_scale: Annotated[float, Meta(gt=1e-9, lt=1e9)] = 1.0


def _read(path: Path, kind: type[T]) -> T:
    what = "dataparser_transforms.json" if kind is _DataParser else "transforms.json"
    try:
        return read_json_as(path, kind)
    except OSError as error:
        reason = (error.strerror or "").lower()
        raise UserError(f"--path-world {path}: expected {what}, got '{reason}'; check the file") from error
    except ValueError as error:
        raise UserError(f"--path-world {path}: expected nerfstudio's {what}, got another file ({error})") from error


def _rigid(path: Path, key: str, values: Sequence[Sequence[float]]) -> tuple[Array, Array]:
    try:
        return rigid_transform(values)
    except ValueError as error:
        raise UserError(f"--path-world {path}: {key}: {error}; export it again") from error


def opengl_pose(camera_to_world: Array, field_of_view: float, focus: Array | None) -> Pose:
    """Return the pose of a camera whose axes are those of OpenGL: x right, y up, z backwards.

    Args:
        camera_to_world: (4, 4) or (3, 4).
        field_of_view: vertical field of view in radians.
        focus: (3,) world point. The pivot is the point on the viewing axis that is nearest to it, or 1 unit in front
            of the camera if this point is behind the camera.

    Raises:
        ValueError: if the matrix does not have a rotation.
    """
    axes, eye = rigid_transform(camera_to_world)
    rotation = (axes @ np.diag([1.0, -1.0, -1.0])).T
    ahead = 0.0 if focus is None else float((focus - eye) @ rotation[2])
    distance = ahead if math.isfinite(ahead) and ahead > 1e-3 else 1.0
    return Pose(eye + distance * rotation[2], rotation, distance, field_of_view, -rotation[1])


def opengl_matrix(pose: Pose) -> Array:
    """Return the camera-to-world matrix (4, 4) of a pose, with the axes of OpenGL."""
    matrix = np.eye(4)
    matrix[:3, :3] = pose.rotation.T @ np.diag([1.0, -1.0, -1.0])
    matrix[:3, 3] = pose.eye
    return matrix
