"""The Playback section: play, pause, step, seek and speed."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState


def _draw(state: ViewerState) -> None:
    scene, playback = state.session.scene, state.session.playback
    assert scene is not None
    if imgui.button("Pause" if playback.is_playing else "Play"):
        playback.toggle()
    imgui.same_line()
    if imgui.button("<"):
        playback.step(-1)
    imgui.same_line()
    if imgui.button(">"):
        playback.step(1)
    imgui.same_line()
    _, playback.is_looping = imgui.checkbox("loop", playback.is_looping)
    changed, frame = imgui.slider_int("frame", playback.frame, 0, playback.frame_count - 1)
    if changed:
        playback.seek(frame)
    _, playback.speed = imgui.slider_float("speed", playback.speed, -4.0, 4.0, "%.2f x")
    imgui.text_disabled(f"{playback.fps * playback.speed:.3g} fps, {scene.frames.frames_ahead} frames prefetched")


PLAYBACK = Section("Playback", _draw)
