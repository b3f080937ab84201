"""The options of `fourd render` for lenses, mirrors and glass balls."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, estimate_up
from fourd.base.errors import UserError
from fourd.cli.help import RARE
from fourd.cli.options import option
from fourd.scene.lenses.inserts import GlassBall, Insert, MirrorFloor
from fourd.scene.lenses.lens import Fisheye, Lens, Panorama, Pinhole, ThinLens

_MAX_SAMPLES = 64
_FLOOR_RADII = 2.5
"""Radius of the mirror floor, as a multiple of the radius of the subject."""


@dataclass(frozen=True)
class LensOptions:
    """Images through a lens are made by tracing rays on the CPU, because a rasterizer supports only pinhole cameras."""

    lens: Annotated[
        Literal["pinhole", "fisheye", "panorama", "thin-lens"] | None, option("LENS", "none: images are rasterized")
    ] = None
    """Trace rays through a lens: pinhole, fisheye, panorama or thin-lens. A panorama covers 360 x 180 degrees around
    the camera and needs a --size with twice as many columns as rows. A thin lens has depth of field."""
    fov: Annotated[float, RARE] = 180.0
    """Field of view of a fisheye image in degrees, up to 360."""
    aperture: Annotated[float | None, RARE, option("FLOAT", "5% of the distance to the focus")] = None
    """Diameter of the thin lens in world units. A larger lens blurs more."""
    focus_distance: Annotated[float | None, RARE, option("FLOAT", "the distance to the scene's focus")] = None
    """Depth at which the thin lens is in focus, in world units."""
    lens_samples: Annotated[int | None, RARE, option("INT", "2; 32 for thin-lens")] = None
    """Number of rays per pixel along each image axis, 1 to 64. For thin-lens, the total number of rays per pixel."""
    mirror_floor: Annotated[bool, RARE] = False
    """Add a round mirror under the subject."""
    glass_ball: Annotated[str | None, RARE, option("auto|X,Y,Z,R", "none")] = None
    """Add a glass ball to the scene, with its centre and radius in world units. auto places the ball on the floor
    beside the subject.
    """

    @property
    def is_used(self) -> bool:
        """Whether images are ray-traced."""
        return self.lens is not None or self.mirror_floor or self.glass_ball is not None


def make_lens(options: LensOptions, camera: Camera, focus: NDArray[np.float64], eye_right: float = 0.0) -> Lens:
    """Return the lens that the options describe. The default focus distance of a thin lens is the depth of the scene's
    focus point ``focus`` in ``camera``, and the default aperture is proportional to the focus distance. A panorama is
    that of an eye at ``eye_right``, see :class:`~fourd.scene.lenses.lens.Panorama`.

    Raises:
        UserError: if an option is out of range.
    """
    samples = options.lens_samples
    if samples is not None and not 1 <= samples <= _MAX_SAMPLES:
        raise UserError(f"--lens-samples: expected 1 to {_MAX_SAMPLES}, got {samples}")
    if not 0 < options.fov <= 360:
        raise UserError(f"--fov: expected more than 0 and at most 360 degrees, got {options.fov:g}")
    if options.lens == "fisheye":
        return Fisheye(options.fov, samples or 2)
    if options.lens == "panorama":
        return Panorama(samples or 2, eye_right)
    if options.lens != "thin-lens":
        return Pinhole(samples or 2)
    distance = (
        float(camera.forward @ (focus - camera.centre)) if options.focus_distance is None else options.focus_distance
    )
    if not 0 < distance < np.inf:
        raise UserError(f"--focus-distance: expected a distance above 0, got {distance:g}; name the distance")
    aperture = 0.05 * distance if options.aperture is None else options.aperture
    if not 0 <= aperture < np.inf:
        raise UserError(f"--aperture: expected a diameter of at least 0, got {aperture:g}")
    return ThinLens(aperture, distance, samples or 32)


def make_inserts(options: LensOptions, cameras: list[Camera], subject: NDArray[np.float32]) -> tuple[Insert, ...]:
    """Return the mirror floor and the glass ball that the options request. Their default positions and sizes are
    computed from the subject's points ``subject`` (N, 3).

    Raises:
        UserError: if the value of --glass-ball is neither "auto" nor four valid numbers, or if the subject has no
            points.
    """
    if not options.mirror_floor and options.glass_ball is None:
        return ()
    if len(subject) == 0 or not cameras:
        raise UserError("--mirror-floor, --glass-ball: expected a scene with cameras and points, got none")
    up = estimate_up(cameras)
    points = subject.astype(np.float64)
    middle = np.median(points, axis=0)
    heights = (points - middle) @ up
    across = points - middle - heights[:, None] * up
    radius = float(np.percentile(np.linalg.norm(across, axis=1), 99.5))
    # The floor is at a low percentile of the heights, so that a few stray points below the subject do not lower it.
    floor = middle + float(np.percentile(heights, 0.1)) * up
    inserts: list[Insert] = []
    if options.mirror_floor:
        inserts.append(MirrorFloor(floor, up, _FLOOR_RADII * max(radius, 1e-9)))
    if options.glass_ball is not None:
        inserts.append(_glass_ball(options.glass_ball, cameras, floor, up, radius))
    return tuple(inserts)


def _glass_ball(
    text: str, cameras: list[Camera], floor: NDArray[np.float64], up: NDArray[np.float64], radius: float
) -> GlassBall:
    if text == "auto":
        size = 0.28 * radius
        # The ball is placed on the subject's side that faces the first camera, and to the right of the subject, so that
        # the subject is visible both through the ball and beside the ball.
        right = np.cross(up, floor - cameras[0].centre)
        right /= -np.linalg.norm(right)
        forward = np.cross(right, up)
        aside = 0.9 * right - 0.6 * forward * np.sign(float(forward @ (floor - cameras[0].centre)))
        return GlassBall(floor + radius * aside + size * up, size)
    parts = text.split(",")
    try:
        x, y, z, ball = (float(part) for part in parts)
    except ValueError:
        raise UserError(f"--glass-ball: expected auto or four numbers X,Y,Z,R, got '{text}'") from None
    if not (ball > 0 and np.isfinite([x, y, z, ball]).all()):
        raise UserError(f"--glass-ball: expected finite numbers and a radius above 0, got '{text}'")
    return GlassBall(np.array([x, y, z]), ball)
