"""Combines two scenes in one place. Their points are composited together, so that each hides the other where it is
nearer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fourd.scene.editing.sources import FrameSource, Mapped, Shadow
from fourd.scene.packing.light import LIGHT_SH_BASE, LIGHT_SH_RANGE, LightFit
from fourd.scene.scene import BakedFrame, SceneManifest, make_frame, to_triple


def without_views(source: FrameSource) -> FrameSource:
    """Return the scene with colours in spherical harmonics instead of source views, as in scenes of the tier "light".
    Scenes of different rigs can only be combined in this form. Normals are left out."""
    before = source.manifest
    fit = LightFit(before)
    after = replace(
        before,
        source_names=(),
        source_cameras=(),
        other_names=before.names,
        other_cameras=before.cameras,
        sh_base=LIGHT_SH_BASE,
        sh_range=LIGHT_SH_RANGE,
        optional_attributes=(),
    )
    return Mapped(source, after, lambda frame: replace(fit.convert(frame), normals=None))


@dataclass(frozen=True)
class Merged:
    """The frames of ``first``, each with the points of the frame of ``second`` at the same time. A shorter second scene
    repeats. Its background is left out. Both are results of :func:`without_views`."""

    first: FrameSource
    second: FrameSource

    @cached_property
    def manifest(self) -> SceneManifest:
        one, two = self.first.manifest, self.second.manifest
        return replace(
            one,
            bounds=(
                to_triple(np.minimum(one.bounds[0], two.bounds[0])),
                to_triple(np.maximum(one.bounds[1], two.bounds[1])),
            ),
            near=min(one.near, two.near),
            layers=max(one.layers, two.layers),
            points=(),
        )

    def read_dynamic(self, index: int) -> BakedFrame:
        one, two = self.first.manifest, self.second.manifest
        other = int(index / one.fps * two.fps + 1e-6) % two.frame_count
        return concatenate(self.first.read_dynamic(index), self.second.read_dynamic(other))

    def read_background(self) -> BakedFrame | None:
        return self.first.read_background()

    def read_shadow(self, index: int) -> Shadow | None:
        return None


@dataclass(frozen=True)
class OnBackground:
    """The subject of ``source`` before the static points of ``scenery``. Both are results of :func:`without_views`."""

    source: FrameSource
    scenery: FrameSource

    @cached_property
    def manifest(self) -> SceneManifest:
        one, two = self.source.manifest, self.scenery.manifest
        return replace(
            one, kind="full", background=None, near=min(one.near, two.near), layers=max(one.layers, two.layers)
        )

    def read_dynamic(self, index: int) -> BakedFrame:
        return self.source.read_dynamic(index)

    def read_background(self) -> BakedFrame | None:
        return self.scenery.read_background()

    def read_shadow(self, index: int) -> Shadow | None:
        return None


def concatenate(first: BakedFrame, second: BakedFrame) -> BakedFrame:
    """Return the points of two frames with the same attributes and numbers of source views, in one frame."""
    one, two = first.arrays, second.arrays
    return make_frame({name: np.concatenate([array, two[name]]) for name, array in one.items()})
