"""The summary of the open scene."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    scene = state.session.scene
    if scene is None:
        imgui.text_wrapped("Drop a .4dv file or a run's folder on this window.")
        return
    imgui.text_wrapped(scene.path.name)
    manifest = scene.manifest
    points = f", {max(manifest.points):,} points" if manifest.points else ""
    imgui.text_disabled(f"{manifest.frame_count} frames{points}, {manifest.view_count} source views")
    if manifest.background is not None:
        imgui.text_disabled(f"background: {manifest.background.points:,} points")
    if scene.checkpoint:
        imgui.text_disabled(f"checkpoint: {scene.checkpoint}")


SCENE = Section("", _draw, needs_scene=False)
