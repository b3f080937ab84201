"""Mouse navigation and keyboard shortcuts, as in Blender and three.js OrbitControls."""

from __future__ import annotations

import math

from imgui_bundle import imgui

from fourd.viewer.navigation.pose import Pose
from fourd.viewer.rendering.renderers import RENDERERS
from fourd.viewer.session import Session
from fourd.viewer.state import ViewerState

HELP = (
    ("left or middle drag", "orbit"),
    ("right or Shift + drag", "pan"),
    ("wheel, Ctrl + drag", "dolly"),
    ("W A S D", "fly"),
    ("Q, E", "fly down, fly up"),
    ("Shift + fly keys", "fly faster"),
    ("Space", "play or pause"),
    ("Left, Right", "previous frame, next frame"),
    ("Home, End", "first frame, last frame"),
    ("[ and ]", "play slower, play faster"),
    ("N, P", "next camera, previous camera"),
    ("0", "initial view"),
    ("R", "next renderer"),
    ("T", "next style"),
    ("F9", "start or stop recording the camera path"),
    ("F10", "render the recorded path to MP4"),
    ("F12", "screenshot"),
    ("Tab", "hide or show this panel"),
)

_LEFT, _RIGHT, _MIDDLE = 0, 1, 2
_WHEEL_FACTOR = 0.9
"""Factor by which one notch of the mouse wheel multiplies the distance to the pivot."""
_SECONDS_TO_PIVOT = 2.0
"""Time in seconds to fly from the eye to the pivot."""
_SHIFT_FACTOR = 4.0
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def handle_navigation(session: Session, window_height: float, seconds: float) -> bool:
    """Move the pose by mouse and keys, unless the panel uses the input. ``window_height`` is in window coordinates.

    Returns True if the pose has changed. Window events do not report every change: a key that is held down moves the
    pose but produces no event.
    """
    io = imgui.get_io()
    if session.pose is None:
        return False
    pose = session.pose
    if not io.want_capture_mouse:
        pose = _drag(pose, io, window_height)
        if io.mouse_wheel:
            pose = pose.dolly(_WHEEL_FACTOR**io.mouse_wheel)
    if not io.want_text_input:
        pose = _fly(pose, io, seconds)
    if pose is session.pose:
        return False
    session.set_pose(pose)
    return True


def handle_shortcuts(state: ViewerState) -> None:
    """Handle the keys that show or hide the panel, take a screenshot, switch the renderer or the style, record or
    render a camera path, and move to a capture camera or the initial view."""
    if imgui.get_io().want_text_input:
        return
    if imgui.is_key_pressed(imgui.Key.tab, False):
        state.is_panel_open = not state.is_panel_open
    if imgui.is_key_pressed(imgui.Key.f12, False):
        state.defer(state.take_screenshot)
    scene = state.session.scene
    if scene is None:
        return
    if imgui.is_key_pressed(imgui.Key.r, False):
        next_renderer = RENDERERS[(RENDERERS.index(state.renderer.choice.name) + 1) % len(RENDERERS)]
        state.defer(lambda: state.switch_renderer(next_renderer))
    if imgui.is_key_pressed(imgui.Key.t, False):
        names = state.session.style_names
        state.session.choose_style(names[(names.index(state.session.style_name) + 1) % len(names)])
    if imgui.is_key_pressed(imgui.Key.f9, False):
        state.defer(state.toggle_recording)
    if imgui.is_key_pressed(imgui.Key.f10, False):
        state.defer(state.render_recorded_path)
    if imgui.is_key_pressed(imgui.Key._0, False):
        state.move_to_initial_view()
    for key, step in ((imgui.Key.n, 1), (imgui.Key.p, -1)):
        if imgui.is_key_pressed(key, False) and scene.manifest.cameras:
            state.move_to_camera((state.camera_index + step) % len(scene.manifest.cameras))


def handle_playback_keys(session: Session) -> None:
    """Handle the keys that control playback."""
    if imgui.get_io().want_text_input:
        return
    playback = session.playback
    if imgui.is_key_pressed(imgui.Key.space, False):
        playback.toggle()
    if imgui.is_key_pressed(imgui.Key.left_arrow):
        playback.step(-1)
    if imgui.is_key_pressed(imgui.Key.right_arrow):
        playback.step(1)
    if imgui.is_key_pressed(imgui.Key.home, False):
        playback.seek(0)
    if imgui.is_key_pressed(imgui.Key.end, False):
        playback.seek(playback.frame_count - 1)
    for key, direction in ((imgui.Key.left_bracket, -1), (imgui.Key.right_bracket, 1)):
        if imgui.is_key_pressed(key, False):
            playback.speed = _next_speed(playback.speed, direction)


def _drag(pose: Pose, io: imgui.IO, window_height: float) -> Pose:
    right, down = io.mouse_delta.x, io.mouse_delta.y
    if not (right or down):
        return pose
    # A press with a duration above 0 began before this image. A press that begins in this image does not count as a
    # drag yet, because the mouse motion may have come before it.
    left, other, middle = (io.mouse_down_duration[button] > 0 for button in (_LEFT, _RIGHT, _MIDDLE))
    if other or (io.key_shift and (left or middle)):
        return pose.pan(right / window_height, down / window_height)
    if not (left or middle):
        return pose
    if io.key_ctrl:
        return pose.dolly(math.exp(2 * down / window_height))
    # As in OrbitControls, a drag as long as the window's height rotates the view by 360 degrees.
    return pose.orbit(2 * math.pi * right / window_height, 2 * math.pi * down / window_height)


def _fly(pose: Pose, io: imgui.IO, seconds: float) -> Pose:
    if io.key_ctrl or io.key_alt or io.key_super:
        return pose
    axes = (
        (imgui.Key.d, imgui.Key.a),
        (imgui.Key.e, imgui.Key.q),
        (imgui.Key.w, imgui.Key.s),
    )
    right, up, forward = (
        float(imgui.is_key_down(positive)) - float(imgui.is_key_down(negative)) for positive, negative in axes
    )
    if not (right or up or forward):
        return pose
    length = pose.distance / _SECONDS_TO_PIVOT * seconds * (_SHIFT_FACTOR if io.key_shift else 1.0)
    return pose.fly(right * length, up * length, forward * length)


def _next_speed(speed: float, direction: int) -> float:
    """Return the next faster preset speed for direction 1, or the next slower one for direction -1.

    The result has the sign of ``speed``. If there is no such preset, it is ``speed`` itself.
    """
    slower = [value for value in _SPEEDS if value < abs(speed) - 1e-9]
    faster = [value for value in _SPEEDS if value > abs(speed) + 1e-9]
    if direction > 0:
        preset = faster[0] if faster else abs(speed)
    else:
        preset = slower[-1] if slower else abs(speed)
    return math.copysign(preset, speed)
