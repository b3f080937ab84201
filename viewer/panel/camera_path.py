"""The Camera path section: a path of key frames, which can be played, saved and rendered."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from imgui_bundle import imgui

from fourd.viewer.camera_paths.editor import MAX_STEP_S, MIN_STEP_S, PathEditor
from fourd.viewer.camera_paths.motion import Easing
from fourd.viewer.camera_paths.reading import OWN_SUFFIX
from fourd.viewer.keys import add_key_frame
from fourd.viewer.output.paths import unused_path
from fourd.viewer.panel.section import Section
from fourd.viewer.state import ViewerState

_EASINGS: tuple[Easing, ...] = get_args(Easing)
_STEP_WIDTH, _EASING_WIDTH = 56.0, 78.0


def _draw(state: ViewerState) -> None:
    editor = state.path_editor
    if imgui.button("Add key"):
        add_key_frame(state)
    imgui.same_line()
    if imgui.button("Stop##path" if editor.is_playing else "Play##path"):
        editor.toggle()
    imgui.same_line()
    if imgui.button("Load##path"):
        _load(state)
    if editor.keys:
        imgui.same_line()
        if imgui.button("Save##path"):
            state.defer(lambda: _save(state))
        changed, is_loop = imgui.checkbox("closed", editor.is_loop)
        if changed:
            editor.set_loop(is_loop)
        imgui.same_line()
        changed, has_frames = imgui.checkbox("frames of the keys", editor.has_frames)
        if changed:
            editor.set_has_frames(has_frames)
        _draw_keys(state, editor)
        if imgui.button("Render to MP4##path"):
            state.defer(lambda: _render(state))
    _, state.typed_camera_path = imgui.input_text("file", state.typed_camera_path)


def _draw_keys(state: ViewerState, editor: PathEditor) -> None:
    """Draw a line for each key frame: a button that moves there, the seconds since the one before, the easing, and a
    button that removes it."""
    fps, removed, scale = state.session.playback.fps, None, state.text_scale
    for index, key in enumerate(editor.keys):
        if imgui.button(f"{index + 1}:  {key.frame / fps:.2f} s##key{index}"):
            editor.playing_s = None
            state.session.playback.is_playing = False
            state.session.playback.seek(round(key.frame))
            state.session.move_to(key.pose, is_free=True)
        if index > 0 or editor.is_loop:
            imgui.same_line()
            imgui.set_next_item_width(_STEP_WIDTH * scale)
            changed, step = imgui.drag_float(f"##step{index}", key.step_s, 0.05, MIN_STEP_S, MAX_STEP_S, "+%.2f s")
            if changed:
                editor.change(index, step_s=step)
        imgui.same_line()
        imgui.set_next_item_width(_EASING_WIDTH * scale)
        changed, chosen = imgui.combo(f"##easing{index}", _EASINGS.index(key.easing), list(_EASINGS))
        if changed:
            editor.change(index, easing=_EASINGS[chosen])
        imgui.same_line()
        if imgui.small_button(f"x##key{index}"):
            removed = index
    if removed is not None:
        editor.remove(removed)


def _save(state: ViewerState) -> None:
    """Write the path to a new file in the working directory, whose name becomes that of the file to load."""
    if state.session.scene is None:
        return
    path = unused_path(state.session.scene.path.stem, OWN_SUFFIX)
    state.write(path, lambda: state.path_editor.save(path))
    state.typed_camera_path = str(path)


def _load(state: ViewerState) -> None:
    if not state.typed_camera_path:
        state.session.message = "expected the name of a path file, got none; type it below, or drop it on the window"
        return
    state.session.message = state.path_editor.try_load(Path(state.typed_camera_path))


def _render(state: ViewerState) -> None:
    scene = state.session.scene
    if scene is not None:
        state.recorded_path = state.path_editor.recording(scene.manifest.frame_count, scene.manifest.fps)
        state.render_recorded_path()


CAMERA_PATH = Section("Camera path", _draw, is_open=False)
