"""The options of `fourd render` for stereo pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.cli.help import RARE
from fourd.cli.options import option

if TYPE_CHECKING:
    from rich.console import Console

    from fourd.scene.playable import Playable

EYE_DISTANCE_M = 0.063
"""Mean distance of the eyes of adults, in metres."""
_EYE_SHARE = 1 / 30
"""Distance of the eyes as a share of the distance to the subject, if the unit of the scene is not known. A common rule
of stereo photography."""


@dataclass(frozen=True)
class StereoOptions:
    """Pairs of images for both eyes, in one image: the left eye's at the left or at the top. --size is the size of the
    image of one eye."""

    stereo: Annotated[Literal["side-by-side", "top-bottom"] | None, option("{side-by-side,top-bottom}", "none")] = None
    """Render a stereo pair: side-by-side or top-bottom. With --lens panorama, the pair is an omnidirectional stereo
    panorama for headsets."""
    eye_distance: Annotated[float | None, RARE, option("FLOAT", "0.063 m, or 1/30 of the distance to the focus")] = None
    """Distance between the eyes in world units."""
    convergence: Annotated[float | None, RARE, option("FLOAT", "parallel viewing axes")] = None
    """Depth, in world units, at which both eyes see a point at the same place of their images. On a screen, nearer
    points appear in front of it. Headsets need parallel viewing axes."""


@dataclass(frozen=True)
class Eyes:
    """The eyes from which an image is rendered.

    Attributes:
        rights: distance of each eye to the right of the camera, in world units: one eye at 0, or two eyes.
        convergence: depth at which the viewing directions of both eyes meet, in world units, or infinity.
        is_vertical: whether the image of the left eye is above that of the right eye, and not beside it.
    """

    rights: tuple[float, ...] = (0.0,)
    convergence: float = np.inf
    is_vertical: bool = False

    def camera(self, camera: Camera, right: float) -> Camera:
        """Return the camera of the eye at ``right``."""
        if right == 0:
            return camera
        intrinsics = camera.intrinsics.copy()
        intrinsics[0, 2] += intrinsics[0, 0] * right / self.convergence
        return replace(camera, intrinsics=intrinsics, translation=camera.translation - (right, 0, 0))

    def join(self, images: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return the images (H, W, C) of the eyes as one image."""
        return images[0] if len(images) == 1 else np.concatenate(images, axis=0 if self.is_vertical else 1)


def make_eyes(options: StereoOptions, playable: Playable, console: Console) -> Eyes:
    """Return the eyes that the options describe, and print their distance if the user has not stated it.

    Raises:
        UserError: if a distance is not above 0, or if a distance is given without --stereo.
    """
    from fourd.scene.playable import metres_per_unit

    for name, value in (("--eye-distance", options.eye_distance), ("--convergence", options.convergence)):
        if value is not None and not 0 < value < np.inf:
            raise UserError(f"{name}: expected a distance above 0, got {value:g}")
        if value is not None and options.stereo is None:
            raise UserError(f"{name}: expected --stereo side-by-side or --stereo top-bottom with it, got none; add it")
    if options.stereo is None:
        return Eyes()
    distance, unit, views = options.eye_distance, metres_per_unit(playable), list(playable.views.values())
    if distance is None and unit is not None:
        distance = EYE_DISTANCE_M / unit
        console.print(f"eye distance: {distance:.4g} world units ({EYE_DISTANCE_M:g} m)")
    elif distance is None:
        if not views:
            raise UserError("--stereo: expected --eye-distance, because the scene has neither a unit nor cameras")
        focus = np.asarray(playable.focus)
        distance = _EYE_SHARE * float(np.median([np.linalg.norm(view.centre - focus) for view in views]))
        console.print(f"eye distance: {distance:.4g} world units (1/30 of the cameras' distance to the focus)")
    half = distance / 2
    return Eyes((-half, half), options.convergence or np.inf, options.stereo == "top-bottom")
