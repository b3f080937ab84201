"""The Viewpoint section: capture camera, field of view and initial view."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from imgui_bundle import imgui

from fourd.viewer.navigation.pose import MAX_FIELD_OF_VIEW, MIN_FIELD_OF_VIEW
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState

FREE = "free"
"""Name of a view that is not that of a camera."""


def _draw(state: ViewerState) -> None:
    scene, pose = state.session.scene, state.session.pose
    if scene is None or pose is None:
        return
    if scene.manifest.cameras:
        _draw_cameras(state, scene.manifest.names, scene.camera_order)
    changed, degrees = imgui.slider_float(
        "field of view",
        float(np.degrees(pose.field_of_view)),
        float(np.degrees(MIN_FIELD_OF_VIEW)),
        float(np.degrees(MAX_FIELD_OF_VIEW)),
        "%.1f deg",
    )
    if changed:
        state.session.set_pose(pose.with_field_of_view(float(np.radians(degrees))))
    if imgui.button("Initial view"):
        state.move_to_initial_view()
    imgui.same_line()
    if imgui.button("Bookmark"):
        state.add_bookmark()
    _draw_bookmarks(state)


def _draw_bookmarks(state: ViewerState) -> None:
    """Draw a line for each kept view, with a button that forgets it."""
    fps, removed = state.session.playback.fps, None
    for index, view in enumerate(state.bookmarks.kept):
        if imgui.button(f"{index + 1}:  {view.frame / fps:.2f} s##view{index}"):
            state.move_to_bookmark(index)
        imgui.same_line()
        if imgui.small_button(f"Remove##view{index}"):
            removed = index
    if removed is not None:
        state.bookmarks.remove(removed)


def _draw_cameras(state: ViewerState, names: Sequence[str], order: Sequence[int]) -> None:
    """Draw the list of cameras in an order, which shows "free" while the view is not that of a camera."""
    is_free = state.session.is_free
    shown = FREE if is_free else names[state.camera_index]
    if not imgui.begin_combo("camera", shown, imgui.ComboFlags_.height_largest):
        return
    for index in order:
        if imgui.selectable(f"{names[index]}##{index}", not is_free and index == state.camera_index)[0]:
            state.move_to_camera(index)
    imgui.end_combo()


VIEWPOINT = Section("Viewpoint", _draw)
