"""Frames of a scene after one edit. Edits follow one another: each is computed from the frames that the one before
returns, so that one frame at a time is in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.scene.editing.floaters import keep_large_parts
from fourd.scene.editing.regions import Region
from fourd.scene.editing.similarity import Similarity
from fourd.scene.editing.tint import Tint
from fourd.scene.scene import BakedFrame, SceneManifest, make_frame

Shadow = NDArray[np.uint8]


class FrameSource(Protocol):
    """A scene whose frames can be read one by one, such as a :class:`fourd.scene.container.SceneReader`."""

    @property
    def manifest(self) -> SceneManifest:
        """Metadata of the frames. Its numbers of points may be out of date."""

    def read_dynamic(self, index: int) -> BakedFrame:
        """Return the dynamic points of the frame with the 0-based ``index``."""

    def read_background(self) -> BakedFrame | None:
        """Return the static points, or None if there are none."""

    def read_shadow(self, index: int) -> Shadow | None:
        """Return a frame's shadow on the static points, (M,) uint8 in units of 1/128, or None if there is none."""


@dataclass(frozen=True)
class Trimmed:
    """The frames with the indices ``chosen``."""

    source: FrameSource
    chosen: Sequence[int]

    @cached_property
    def manifest(self) -> SceneManifest:
        before = self.source.manifest
        points = tuple(before.points[index] for index in self.chosen) if before.points else ()
        return replace(before, frame_numbers=tuple(before.frame_numbers[index] for index in self.chosen), points=points)

    def read_dynamic(self, index: int) -> BakedFrame:
        return self.source.read_dynamic(self.chosen[index])

    def read_background(self) -> BakedFrame | None:
        return self.source.read_background()

    def read_shadow(self, index: int) -> Shadow | None:
        return self.source.read_shadow(self.chosen[index])


@dataclass(frozen=True)
class Mapped:
    """A scene whose points are changed one by one.

    Attributes:
        source: the scene.
        manifest: metadata after the change.
        change: returns the changed points of a frame or of the background, in the same order.
    """

    source: FrameSource
    manifest: SceneManifest
    change: Callable[[BakedFrame], BakedFrame]

    def read_dynamic(self, index: int) -> BakedFrame:
        return self.change(self.source.read_dynamic(index))

    def read_background(self) -> BakedFrame | None:
        return self._background

    def read_shadow(self, index: int) -> Shadow | None:
        return self.source.read_shadow(index)

    @cached_property
    def _background(self) -> BakedFrame | None:
        background = self.source.read_background()
        return None if background is None else self.change(background)


@dataclass(frozen=True)
class Cropped:
    """The points inside all ``regions``. With ``floater_share``, dynamic points in groups of fewer points than this
    share of the frame's largest group are left out, see :mod:`fourd.scene.editing.floaters`."""

    source: FrameSource
    regions: tuple[Region, ...]
    floater_share: float | None = None

    @cached_property
    def manifest(self) -> SceneManifest:
        return self.source.manifest

    def read_dynamic(self, index: int) -> BakedFrame:
        frame = self.source.read_dynamic(index)
        frame = select_points(frame, self._inside(frame.xyz))
        if self.floater_share is not None:
            frame = select_points(frame, keep_large_parts(frame.xyz, self.floater_share))
        return frame

    def read_background(self) -> BakedFrame | None:
        background = self.source.read_background()
        return background if background is None else select_points(background, self._kept_background)

    def read_shadow(self, index: int) -> Shadow | None:
        shadow = self.source.read_shadow(index)
        return None if shadow is None else shadow[self._kept_background]

    def _inside(self, xyz: NDArray[np.float32]) -> NDArray[np.bool_]:
        kept = np.ones(len(xyz), bool)
        for region in self.regions:
            kept &= region.contains(xyz)
        return kept

    @cached_property
    def _kept_background(self) -> NDArray[np.bool_]:
        background = self.source.read_background()
        assert background is not None
        return self._inside(background.xyz)


@dataclass(frozen=True)
class WithoutBackground:
    """The subject of a full scene."""

    source: FrameSource

    @cached_property
    def manifest(self) -> SceneManifest:
        return replace(self.source.manifest, kind="object", background=None)

    def read_dynamic(self, index: int) -> BakedFrame:
        return self.source.read_dynamic(index)

    def read_background(self) -> BakedFrame | None:
        return None

    def read_shadow(self, index: int) -> Shadow | None:
        return None


def tinted(source: FrameSource, tint: Tint) -> FrameSource:
    """Return the scene with its colours multiplied."""
    before = source.manifest
    return Mapped(source, tint.manifest(before), lambda frame: tint.frame(frame, before))


def moved(source: FrameSource, similarity: Similarity) -> FrameSource:
    """Return the transformed scene."""
    return Mapped(source, similarity.manifest(source.manifest), similarity.frame)


def select_points(frame: BakedFrame, kept: NDArray[np.bool_]) -> BakedFrame:
    """Return the points of a frame where ``kept`` (N,) is true."""
    return frame if kept.all() else make_frame({name: array[kept] for name, array in frame.arrays.items()})
