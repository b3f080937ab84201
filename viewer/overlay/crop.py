"""Draws the edges of the crop box over the picture."""

from __future__ import annotations

import itertools

import numpy as np
from imgui_bundle import imgui

from fourd.viewer.state import ViewerState


def draw_crop_box(state: ViewerState) -> None:
    """Draw the edges of the crop box, if the section Crop was drawn in the last image. Edges that reach behind the
    camera are left out."""
    session, is_shown = state.session, state.is_box_shown
    state.is_box_shown = False
    if not is_shown or session.settings.crop is None or session.pose is None:
        return
    camera = session.pose.camera(*state.window.framebuffer_size, state.picture_shift)
    crop = session.settings.crop
    corners = np.array(list(itertools.product(*zip(crop.lower, crop.upper, strict=True))))
    pixels, depth = camera.project(corners)
    at = pixels / state.pixels_per_unit
    drawing, colour = imgui.get_background_draw_list(), imgui.IM_COL32(255, 190, 60, 220)
    for one, other in itertools.combinations(range(8), 2):
        # The numbers of the two corners of an edge differ in one bit, that of the edge's axis.
        if one ^ other in (1, 2, 4) and min(depth[one], depth[other]) > 0:
            start, end = (imgui.ImVec2(float(at[index][0]), float(at[index][1])) for index in (one, other))
            drawing.add_line(start, end, colour, 1.5 * state.text_scale)
