"""Draws the edges of the crop box over the picture."""

from __future__ import annotations

import itertools

import numpy as np
from imgui_bundle import imgui

from fourd.viewer.overlay.views import shown_views
from fourd.viewer.state import ViewerState


def draw_crop_box(state: ViewerState) -> None:
    """Draw the edges of the crop box, if the section Crop was drawn in the last image. Edges that reach behind the
    camera are left out."""
    session, is_shown = state.session, state.is_box_shown
    state.is_box_shown = False
    if not is_shown or session.settings.crop is None or session.pose is None:
        return
    crop = session.settings.crop
    corners = np.array(list(itertools.product(*zip(crop.lower, crop.upper, strict=True))))
    drawing, colour = imgui.get_background_draw_list(), imgui.IM_COL32(255, 190, 60, 220)
    for view in shown_views(state):
        at = [view.in_window(corner) for corner in corners]
        with view.clipped(drawing):
            for one, other in itertools.combinations(range(8), 2):
                start, end = at[one], at[other]
                # The numbers of the two corners of an edge differ in one bit, that of the edge's axis.
                if one ^ other in (1, 2, 4) and start is not None and end is not None:
                    drawing.add_line(start, end, colour, 1.5 * state.text_scale)
