"""The Viewpoint section: capture camera, field of view and initial view."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui

from fourd.viewer.navigation.pose import MAX_FIELD_OF_VIEW, MIN_FIELD_OF_VIEW
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    scene, pose = state.session.scene, state.session.pose
    if scene is None or pose is None:
        return
    if scene.manifest.cameras:
        state.camera_index = min(state.camera_index, len(scene.manifest.cameras) - 1)
        changed, index = imgui.combo("camera", state.camera_index, list(scene.manifest.names))
        if changed:
            state.move_to_camera(index)
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


VIEWPOINT = Section("Viewpoint", _draw)
