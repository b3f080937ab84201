"""The parts of the window that show the scene or what it is compared with, and the camera of each part."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from imgui_bundle import imgui
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.viewer.comparison.placement import compared_area
from fourd.viewer.interface.layout import Area
from fourd.viewer.overlay.label import corners
from fourd.viewer.state import ViewerState


@dataclass(frozen=True)
class ShownView:
    """A part of the window.

    Attributes:
        area: the part, in window coordinates.
        camera: the camera of an image as large as the framebuffer, of which this part is visible. None for a captured
            picture of another view, which shows no known place of the scene.
        pixels_per_unit: pixels of the framebuffer per window coordinate.
        is_other: whether the part shows the other scene.
    """

    area: Area
    camera: Camera | None
    pixels_per_unit: float
    is_other: bool = False

    def in_window(self, place: NDArray[np.float64]) -> imgui.ImVec2 | None:
        """Return the position of a place (3,) in window coordinates, or None if the part does not show it or it is
        behind the camera."""
        if self.camera is None:
            return None
        pixels, depth = self.camera.project(place[None])
        if depth[0] <= 0:
            return None
        x, y = pixels[0] / self.pixels_per_unit
        return imgui.ImVec2(float(x), float(y))

    @contextmanager
    def clipped(self, drawing: imgui.ImDrawList) -> Iterator[None]:
        """Draw only in this part of the window."""
        drawing.push_clip_rect(*corners(self.area), True)
        try:
            yield
        finally:
            drawing.pop_clip_rect()


def shown_views(state: ViewerState) -> tuple[ShownView, ...]:
    """Return the parts of the window, from left to right. There are none while no scene is open."""
    comparison, free, pose = state.comparison, state.layout.free, state.session.pose
    if pose is None:
        return ()
    size, scale = state.window.framebuffer_size, state.pixels_per_unit
    main = pose.camera(*size, state.picture_shift)
    if not comparison.is_on or (comparison.other is None and comparison.mode == "wipe"):
        return (ShownView(free, main, scale),)  # the captured picture lies exactly over the scene
    has_other, is_beside = comparison.other is not None, comparison.mode == "side by side"
    left, right = free.split(0.5 if is_beside else comparison.share)
    moved = pose.camera(*size, state.shift_to(compared_area(free, comparison.mode)))
    has_view = has_other or state.compared_camera is not None
    return ShownView(left, moved if has_view else None, scale, has_other), ShownView(right, main, scale)
