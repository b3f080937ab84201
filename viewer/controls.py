"""Navigation by mouse and keys, as in Blender and three.js OrbitControls."""

from __future__ import annotations

import math

from imgui_bundle import imgui

from fourd.viewer.navigation.pose import Pose
from fourd.viewer.session import Session

_LEFT, _RIGHT, _MIDDLE = 0, 1, 2
_WHEEL_FACTOR = 0.9
"""Factor by which one notch of the mouse wheel multiplies the distance to the pivot."""
_SECONDS_TO_PIVOT = 2.0
"""Time in seconds to fly from the eye to the pivot."""
_SHIFT_FACTOR = 4.0


def handle_navigation(
    session: Session, window: tuple[float, float], seconds: float, centre: tuple[float, float] | None = None
) -> bool:
    """Move the pose by mouse and keys, unless the panel uses the input. ``window`` is the (width, height) in window
    coordinates.

    While the view is that of a camera whose picture is compared, ``centre`` is where the middle of the image is, in
    window coordinates. The wheel and the right button then enlarge and move the image, and the eye stays at its place.

    Returns True if the pose has changed. Window events do not report every change: a key that is held down moves the
    pose but produces no event.
    """
    io = imgui.get_io()
    if session.pose is None:
        return False
    if centre is not None and not io.want_capture_mouse and _zoom(session, io, window[1], centre):
        return True
    pose, window_height = session.pose, window[1]
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


def _zoom(session: Session, io: imgui.IO, height: float, centre: tuple[float, float]) -> bool:
    """Enlarge the image around the mouse, or move it, without moving the eye. Returns True if there was such input."""
    pose = session.pose
    is_dragged = imgui.is_mouse_down(_RIGHT) and (io.mouse_delta.x or io.mouse_delta.y)
    if pose is None or not (io.mouse_wheel or is_dragged):
        return False
    if io.mouse_wheel:
        x, y = (io.mouse_pos.x - centre[0]) / height, (io.mouse_pos.y - centre[1]) / height
        pose = pose.zoom(_WHEEL_FACTOR**-io.mouse_wheel, x, y)
    if is_dragged:
        pose = pose.slide(io.mouse_delta.x / height, io.mouse_delta.y / height)
    session.zoom(pose)
    return True


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
