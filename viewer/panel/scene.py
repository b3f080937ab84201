"""The summary of the open scene."""

from __future__ import annotations

import time

from imgui_bundle import imgui

from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    scene = state.session.scene
    assert scene is not None
    imgui.text_wrapped(scene.path.name)
    manifest = scene.manifest
    points = f", {max(manifest.points):,} points" if manifest.points else ""
    imgui.text_disabled(f"{manifest.frame_count} frames{points}, {manifest.view_count} source views")
    if manifest.background is not None:
        imgui.text_disabled(f"background: {manifest.background.points:,} points")
    if scene.checkpoint:
        imgui.text_disabled(f"checkpoint: {scene.checkpoint}")
    imgui.text_disabled(rate_text(state.renderer.choice.name, state.timings.images_per_second(time.monotonic())))
    if imgui.button("Open..."):
        state.defer(state.choose_file)


def rate_text(renderer: str, images_per_second: float) -> str:
    """Return the name of the renderer and the images that it draws per second, or that it rests."""
    rate = f"{images_per_second:.0f}" if images_per_second >= 9.5 else f"{images_per_second:.1f}"
    return f"{renderer}: {rate} images per second" if images_per_second else f"{renderer}: at rest"


SCENE = Section("", _draw)
