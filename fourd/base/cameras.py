"""The camera type. Cameras follow OpenCV's convention: x points right, y down and z forward. Intrinsics are in pixels.

A world point has camera coordinates ``x_camera = R_camera_world @ x_world + T_camera_world``. The centre of the pixel
in row i and column j is at ``(j + 0.5, i + 0.5)``. All arrays are NumPy arrays of float64. This module does not import
torch, so that scenes can be opened and rendered without torch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FADE_MARGIN = 1.25
"""The weight of a source view decreases with the angle between its camera and the viewing camera, and reaches 0 at a
limit angle. Let A be the largest angle of the cameras that are chosen as source views. Of the other cameras, those at
angles of at least A are considered, and the limit angle is the smallest of their angles. If there is no such camera,
the limit angle is FADE_MARGIN * A; see :func:`fading_weights`.
"""
MAX_LISTED = 8
"""Maximum number of cameras that a message lists."""
EQUAL_POSITION = 1e-4
"""Two cameras have equal positions if their distance is at most this fraction of the largest distance between two
cameras of the rig."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with optional lens distortion.

    Attributes:
        intrinsics: (3, 3) matrix of the intrinsics, in pixels. The last row must be (0, 0, 1).
        rotation: (3, 3) matrix R_camera_world, orthonormal with determinant +1.
        translation: (3,) vector T_camera_world, in world units.
        width: image width in pixels, at least 1.
        height: image height in pixels, at least 1.
        distortion: 4, 5, 8, 12 or 14 OpenCV coefficients (k1, k2, p1, p2, k3, ...), or None for an ideal pinhole.
            Renderers require an ideal pinhole camera, so undistort the images first.

    Raises:
        ValueError: if an array has a wrong shape, a value is not finite, or ``rotation`` is not a rotation matrix
            (tolerance 1e-3). The error message names the invalid field.
    """

    intrinsics: Array
    rotation: Array
    translation: Array
    width: int
    height: int
    distortion: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "intrinsics", _as_array("intrinsics", self.intrinsics, (3, 3)))
        object.__setattr__(self, "rotation", _as_array("rotation", self.rotation, (3, 3)))
        object.__setattr__(self, "translation", _as_array("translation", self.translation, (3,)))
        if self.width < 1 or self.height < 1:
            raise ValueError(f"width and height: expected at least 1 pixel, got {self.width} x {self.height}")
        with np.errstate(over="ignore", invalid="ignore"):
            error = float(np.abs(self.rotation @ self.rotation.T - np.eye(3)).max())
            determinant = float(np.linalg.det(self.rotation))
        if error <= 1e-3 and determinant < 0:
            raise ValueError(
                "rotation: expected a rotation of determinant +1, got a reflection (determinant -1), as poses with one "
                "flipped axis have"
            )
        # "not (error <= ...)" also rejects NaN, which occurs if the matrix product overflows.
        if not (error <= 1e-3 and determinant > 0):
            raise ValueError(
                f"rotation: expected an orthonormal matrix of determinant +1, got one that differs from orthonormal by "
                f"{error:.3g} and has determinant {determinant:.3g}"
            )
        if self.intrinsics[0, 0] <= 0 or self.intrinsics[1, 1] <= 0:
            raise ValueError(
                f"intrinsics: expected positive focal lengths, got "
                f"{self.intrinsics[0, 0]:g} and {self.intrinsics[1, 1]:g}"
            )
        if self.distortion is not None:
            distortion = np.asarray(self.distortion, dtype=np.float64).ravel()
            if distortion.size not in (4, 5, 8, 12, 14) or not np.isfinite(distortion).all():
                raise ValueError(
                    f"distortion: expected 4, 5, 8, 12 or 14 finite coefficients, got {distortion.tolist()}"
                )
            object.__setattr__(self, "distortion", distortion if distortion.any() else None)

    @classmethod
    def from_fov(
        cls,
        fov_y: float,
        width: int,
        height: int,
        *,
        centre: Sequence[float] | Array = (0.0, 0.0, 0.0),
        target: Sequence[float] | Array = (0.0, 0.0, 1.0),
        up: Sequence[float] | Array = (0.0, -1.0, 0.0),
    ) -> Camera:
        """Return a camera with square pixels whose principal point is the centre of the image.

        Args:
            fov_y: vertical field of view in degrees, between 0 and 180.
            width, height: size of the image in pixels.
            centre, target, up: the pose (:func:`look_at`), vectors (3,) in world coordinates. With the default values,
                the camera axes are the world axes.

        Raises:
            ValueError: if ``fov_y`` is out of range, or ``up`` is parallel to the viewing direction.
        """
        if not 0 < fov_y < 180:
            raise ValueError(f"fov_y: expected degrees between 0 and 180, got {fov_y}")
        focal = height / 2 / float(np.tan(np.radians(fov_y) / 2))
        intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        return look_at(centre, target, up, intrinsics, width, height)

    @property
    def centre(self) -> Array:
        """Position of the camera in the world, (3,)."""
        return -self.rotation.T @ self.translation

    @property
    def forward(self) -> Array:
        """Unit viewing direction in the world, (3,)."""
        return self.rotation[2]

    def project(self, xyz: NDArray[np.floating]) -> tuple[Array, Array]:
        """Project world points (N, 3) without lens distortion.

        Returns:
            pixels (N, 2) as (x, y), and camera depth z (N,) in world units. The pixels of points with z <= 0 are not
            valid.
        """
        xyz_camera = np.asarray(xyz, dtype=np.float64) @ self.rotation.T + self.translation
        depth = xyz_camera[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (xyz_camera @ self.intrinsics.T)[:, :2] / depth[:, None]
        return pixels, depth

    def unproject(self, pixels: NDArray[np.floating], depth: NDArray[np.floating]) -> Array:
        """Return the world points (N, 3) that project to the pixels (N, 2) and have the camera depths ``depth`` (N,) in
        world units. Pixels are (x, y) without lens distortion. This is the inverse of :meth:`project`."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self.intrinsics).T
        return np.asarray((rays * depth[:, None] - self.translation) @ self.rotation, np.float64)

    def is_in_image(self, pixels: Array, depth: Array) -> NDArray[np.bool_]:
        """Return a mask (N,) of the points that are in front of the camera and inside its image.

        ``pixels`` and ``depth`` are the results of :meth:`project`.
        """
        inside = (pixels >= 0).all(axis=1) & (pixels <= (self.width, self.height)).all(axis=1)
        return np.asarray((depth > 0) & inside)

    def rescale(self, scale: float) -> Camera:
        """Return this camera with ``scale`` times the image size, rounded to whole pixels.

        The scaled intrinsics match the rounded image size exactly.
        """
        return self.resize(max(1, round(self.width * scale)), max(1, round(self.height * scale)))

    def resize(self, width: int, height: int) -> Camera:
        """Return a camera with the same field of view, whose image has ``width`` x ``height`` pixels."""
        zoom = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, intrinsics=zoom @ self.intrinsics, width=width, height=height)

    def crop(self, left: int, top: int, width: int, height: int) -> Camera:
        """Return this camera for an image cropped to ``width`` x ``height`` pixels from (``left``, ``top``)."""
        intrinsics = self.intrinsics.copy()
        intrinsics[0, 2] -= left
        intrinsics[1, 2] -= top
        return replace(self, intrinsics=intrinsics, width=width, height=height)


def look_at(
    centre: Sequence[float] | Array,
    target: Sequence[float] | Array,
    up: Sequence[float] | Array,
    intrinsics: Array,
    width: int,
    height: int,
) -> Camera:
    """Return a camera at ``centre`` that points at ``target``, with ``up`` towards the top of the image.

    ``centre``, ``target`` and ``up`` are vectors (3,) in world coordinates. Raises ValueError if ``up`` is parallel
    to the viewing direction, or ``target`` equals ``centre``.
    """
    centre = np.asarray(centre, dtype=np.float64)
    forward = np.asarray(target, dtype=np.float64) - centre
    distance = float(np.linalg.norm(forward))
    if distance == 0:
        raise ValueError("target: expected a point that differs from the camera's centre")
    forward = forward / distance
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    length = float(np.linalg.norm(right))
    if length < 1e-9:
        raise ValueError("up: expected a direction that is not parallel to the viewing direction")
    right = right / length
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera(intrinsics, rotation, -rotation @ centre, width, height)


def estimate_up(cameras: Sequence[Camera]) -> Array:
    """Estimate the up direction (3,) of a capture, which a calibration does not define.

    The result is the normalised mean of the cameras' -y axes, which point up in the images. If the axes cancel out, the
    result is the first camera's -y axis.
    """
    mean = np.mean([-camera.rotation[1] for camera in cameras], axis=0)
    if np.linalg.norm(mean) < 1e-3:
        mean = -cameras[0].rotation[1]
    return np.asarray(mean / np.linalg.norm(mean))


@dataclass(frozen=True, eq=False)
class SelectedViews:
    """The source views whose colours are blended for a viewing camera.

    Attributes:
        indices: indices of the V source cameras.
        weights: (V,) float32 view weights in [0, 1], by which the blend weights of every point are multiplied. At least
            one of them is above 0.
    """

    indices: list[int]
    weights: NDArray[np.float32]


def select_views(camera: Camera, sources: Sequence[Camera], count: int, focus: Array, *, fade: bool) -> SelectedViews:
    """Select the ``count`` source cameras nearest to ``camera``; see :func:`nearest_views`.

    If ``fade`` is true, :func:`fading_weights` computes the view weights. Otherwise, they are all 1.
    """
    chosen = nearest_views(camera, sources, count, focus)
    weights = fading_weights(camera, sources, chosen, focus) if fade else np.ones(len(chosen), np.float32)
    return SelectedViews(chosen, weights)


def fading_weights(
    camera: Camera, sources: Sequence[Camera], chosen: Sequence[int], focus: Array
) -> NDArray[np.float32]:
    """Return the view weights (V,) of the V cameras ``chosen``, which decrease with the angle to the viewing camera.

    A chosen camera at the angle a from the viewing camera has the view weight 1 - a / b, where b is the limit angle at
    which the weight reaches 0. Let A be the largest angle of the chosen cameras. Of the cameras that are not chosen,
    those at angles of at least A are candidates, and b is the smallest angle of a candidate. Without candidates, b is
    FADE_MARGIN * A. At the moment when another camera replaces a chosen one, both have the weight 0, so the rendered
    image does not jump (unstructured lumigraph rendering, Buehler et al. 2001, sec. 4). Angles are measured at the
    point ``focus``. If all view weights would be 0, they are 1 instead.

    Args:
        camera: the viewing camera.
        sources: cameras that can be source views. Leave out cameras that must not influence the limit angle.
        chosen: indices of the V chosen cameras, in any order.
        focus: (3,) world point.
    """
    if not chosen:
        return np.ones(0, np.float32)
    angles = _view_angles(camera, sources, focus)
    own = angles[list(chosen)]
    others = np.delete(angles, list(chosen))
    beyond = others[others >= own.max()]
    limit = float(beyond.min()) if len(beyond) else FADE_MARGIN * float(own.max())
    weights = 1 - own / max(limit, 1e-9)
    return np.asarray(weights if weights.max() > 0 else np.ones_like(weights), np.float32)


def nearest_views(camera: Camera, sources: Sequence[Camera], count: int, focus: Array) -> list[int]:
    """Return the indices of the ``count`` source cameras nearest to ``camera`` by angle, nearest first.

    The angle is measured at the world point ``focus`` (3,), between the rays to the centres of ``camera`` and of the
    source camera (4K4D, sec. 3.2). Cameras with equal angles are ordered by index.
    """
    direction = _normalize(camera.centre - focus)
    cosines = np.array([float(_normalize(source.centre - focus) @ direction) for source in sources])
    return [int(i) for i in np.argsort(-cosines, kind="stable")[:count]]


def _view_angles(camera: Camera, sources: Sequence[Camera], focus: Array) -> Array:
    """Return angles (V,) in radians at ``focus`` between the centres of the viewing camera and each source camera."""
    direction = _normalize(camera.centre - focus)
    rays = np.array([_normalize(source.centre - focus) for source in sources]).reshape(-1, 3)
    return np.arctan2(np.linalg.norm(np.cross(rays, direction), axis=1), rays @ direction)


def _normalize(vector: Array) -> Array:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def _as_array(name: str, value: object, shape: tuple[int, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    array.flags.writeable = False
    return array


def equal_positions(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Return the pairs (i, j), i < j, of cameras whose centres are equal within a 10,000th of the largest distance
    between two cameras."""
    centres = np.stack([camera.centre for camera in cameras]) if cameras else np.zeros((0, 3))
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    limit = EQUAL_POSITION * float(distances.max(initial=0))
    return [(int(i), int(j)) for i, j in np.argwhere(distances <= limit) if i < j]


def describe_equal_positions(cameras: Mapping[str, Camera]) -> list[str]:
    """Return one line for each set of cameras at equal positions, with the cameras' names, the keys of ``cameras``."""
    names, views = list(cameras), list(cameras.values())
    sets: list[set[int]] = []
    for i, j in equal_positions(views):
        known = next((each for each in sets if i in each or j in each), None)
        if known is None:
            sets.append({i, j})
        else:
            known |= {i, j}
    lines = []
    for each in sets:
        first, *others = sorted(each)
        same = all(np.allclose(views[first].rotation, views[other].rotation, atol=1e-4) for other in others)
        shown = [f"'{names[index]}'" for index in (first, *others)]
        if len(shown) > MAX_LISTED:
            shown[MAX_LISTED - 1 :] = [f"{len(shown) - MAX_LISTED + 1} more"]
        lines.append(
            f"cameras {', '.join(shown[:-1])} and {shown[-1]} have equal {'calibrations' if same else 'positions'}, so "
            "at most one of them is right; calibrate these cameras again, or leave all but one out"
        )
    return lines
