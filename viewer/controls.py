"""Mouse and keys, as Blender and three.js OrbitControls have them."""

from __future__ import annotations

import math

from imgui_bundle import imgui

from fourd.viewer.navigation.pose import Pose
from fourd.viewer.session import Session

HELP = (
    ("left or middle drag", "orbit"),
    ("right or Shift + drag", "pan"),
    ("wheel, Ctrl + drag", "dolly"),
    ("W A S D, Q E", "fly, down and up; Shift: faster"),
    ("Space", "play, pause"),
    ("Left, Right", "a frame back, on"),
    ("Home, End", "first, last frame"),
    ("[ and ]", "slower, faster"),
    ("N, P", "glide to the next, previous camera"),
    ("0", "back to the first view"),
    ("R", "next renderer"),
    ("F9", "record the path, stop"),
    ("F10", "render the recorded path to MP4"),
    ("F12", "screenshot"),
    ("Tab", "hide or show this panel"),
)

_LEFT, _RIGHT, _MIDDLE = 0, 1, 2
_WHEEL = 0.9  # of the distance, a notch
_SECONDS_ACROSS = 2.0  # to fly as far as the pivot is away
_FASTER = 4.0
_SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def steer(session: Session, height: float, seconds: float) -> bool:
    """Move the viewer by what mouse and keys do, unless the panel has them; ``height`` of the window in its units.

    Returns whether it moved: a key that is held gives no events to wait for.
    """
    io = imgui.get_io()
    if session.pose is None:
        return False
    moved = session.pose
    if not io.want_capture_mouse:
        moved = _dragged(moved, io, height)
        if io.mouse_wheel:
            moved = moved.dollied(_WHEEL**io.mouse_wheel)
    if not io.want_text_input:
        moved = _flown(moved, io, seconds)
    if moved is session.pose:
        return False
    session.move(moved)
    return True


def play(session: Session) -> None:
    """Playback's keys."""
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
        playback.seek(playback.frames - 1)
    for key, on in ((imgui.Key.left_bracket, -1), (imgui.Key.right_bracket, 1)):
        if imgui.is_key_pressed(key, False):
            playback.speed = _next_speed(playback.speed, on)


def _dragged(pose: Pose, io: imgui.IO, height: float) -> Pose:
    right, down = io.mouse_delta.x, io.mouse_delta.y
    if not (right or down):
        return pose
    # Held since the picture before: what the mouse moved until it was pressed is no drag.
    left, other, middle = (io.mouse_down_duration[button] > 0 for button in (_LEFT, _RIGHT, _MIDDLE))
    if other or (io.key_shift and (left or middle)):
        return pose.panned(right / height, down / height)
    if not (left or middle):
        return pose
    if io.key_ctrl:
        return pose.dollied(math.exp(2 * down / height))
    # A drag over the window's height turns once round, as OrbitControls has it.
    return pose.orbited(2 * math.pi * right / height, 2 * math.pi * down / height)


def _flown(pose: Pose, io: imgui.IO, seconds: float) -> Pose:
    if io.key_ctrl or io.key_alt or io.key_super:
        return pose
    axes = (
        (imgui.Key.d, imgui.Key.a),
        (imgui.Key.e, imgui.Key.q),
        (imgui.Key.w, imgui.Key.s),
    )
    right, up, forward = (float(imgui.is_key_down(on)) - float(imgui.is_key_down(off)) for on, off in axes)
    if not (right or up or forward):
        return pose
    length = pose.distance / _SECONDS_ACROSS * seconds * (_FASTER if io.key_shift else 1.0)
    return pose.flown(right * length, up * length, forward * length)


def _next_speed(speed: float, on: int) -> float:
    """The next of the usual speeds in a direction, with the sign kept."""
    slower = [value for value in _SPEEDS if value < abs(speed) - 1e-9]
    faster = [value for value in _SPEEDS if value > abs(speed) + 1e-9]
    chosen = (faster[0] if faster else abs(speed)) if on > 0 else (slower[-1] if slower else abs(speed))
    return math.copysign(chosen, speed)
