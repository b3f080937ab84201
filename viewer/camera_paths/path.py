"""A camera path as a sequence of images: what the readers of all path files return."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fourd.viewer.navigation.pose import interpolate_poses
from fourd.viewer.navigation.recorded_path import PathSample

Array = NDArray[np.float64]
PathLens = Literal["pinhole", "fisheye", "panorama"]


@dataclass(frozen=True, eq=False)
class CameraPath:
    """The images along a camera path.

    Attributes:
        samples: pose and frame index of each image, at least one.
        fps: images per second, above 0.
        has_frames: whether the path says which frame of the scene each image shows. If not, the frames in ``samples``
            are 0, and the scene plays at its own speed.
        is_loop: whether the camera returns to the first image after the last one.
        size: width and height of the images in pixels, or None if the path does not state them.
        lens: lens for which the path was made.
        notes: one line for each part of the file that is not used.
        curve: function that samples the path at times from 0 to 1, (N,), or None if the path is only a sequence of
            samples.
    """

    samples: tuple[PathSample, ...]
    fps: float
    has_frames: bool = True
    is_loop: bool = False
    size: tuple[int, int] | None = None
    lens: PathLens = "pinhole"
    notes: tuple[str, ...] = ()
    curve: Callable[[Array], tuple[PathSample, ...]] | None = None

    def with_count(self, count: int) -> CameraPath:
        """Return the path with ``count`` images, evenly spaced in time. If the count does not change, the samples are
        the same, so that a recorded path gives the same images again."""
        if count == len(self.samples):
            return self
        times = np.arange(count) / count if self.is_loop else np.linspace(0, 1, count)
        samples = self.curve(times) if self.curve is not None else _between(self.samples, times, is_loop=self.is_loop)
        return replace(self, samples=samples)

    def there_and_back(self) -> CameraPath:
        """Return the path to its end and back. The first and the last image are not repeated."""
        return replace(self, samples=(*self.samples, *self.samples[-2:0:-1]), is_loop=True, curve=None)


def _between(samples: Sequence[PathSample], times: Array, *, is_loop: bool) -> tuple[PathSample, ...]:
    """Interpolate linearly between dense samples, at times from 0 to 1."""
    stops = (*samples, samples[0]) if is_loop else tuple(samples)
    found = []
    for at in times * (len(stops) - 1):
        index = min(int(at), len(stops) - 1)
        start, end = stops[index], stops[min(index + 1, len(stops) - 1)]
        share = float(at - index)
        pose = start.pose if share == 0 else interpolate_poses(start.pose, end.pose, share, is_eased=False)
        # Between the last frame and the first one of a loop, there are no other frames.
        last = end.frame if not is_loop or index < len(samples) - 1 else start.frame
        found.append(PathSample(pose, round(start.frame + share * (last - start.frame))))
    return tuple(found)
