"""The keyboard shortcuts of the window. The keys for playback and cameras are the same as in the web player."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from imgui_bundle import imgui

from fourd.viewer.comparison.comparison import MODES
from fourd.viewer.navigation.bookmarks import MAX_BOOKMARKS
from fourd.viewer.playback.clock import SPEEDS
from fourd.viewer.rendering.renderers import RENDERERS
from fourd.viewer.state import ViewerState

MOUSE = (
    ("drag", "orbit"),
    ("right or Shift + drag", "pan"),
    ("wheel, Ctrl + drag", "move nearer or farther"),
    ("W A S D, Q, E", "fly; with Shift faster"),
)
"""Inputs that move the view, and their effects, for the help."""


@dataclass(frozen=True)
class Shortcut:
    """A keyboard shortcut.

    Attributes:
        label: name of the keys in the help.
        effect: what the keys do.
        actions: pairs of a key and the function that it calls.
        needs_scene: whether the keys have no effect while no scene is open.
        needs_ctrl: whether the keys count only while Ctrl is held down. Other keys count only while it is not.
        repeats: whether a key that is held down calls its function again and again.
    """

    label: str
    effect: str
    actions: tuple[tuple[imgui.Key, Callable[[ViewerState], None]], ...]
    needs_scene: bool = True
    needs_ctrl: bool = False
    repeats: bool = False


def handle_keys(state: ViewerState) -> None:
    """Call the functions of the keys that the user has pressed."""
    io = imgui.get_io()
    if io.want_text_input:
        return
    has_scene = state.session.scene is not None
    for shortcut in SHORTCUTS:
        if (shortcut.needs_scene and not has_scene) or shortcut.needs_ctrl != (io.key_ctrl or io.key_super):
            continue
        for key, act in shortcut.actions:
            if imgui.is_key_pressed(key, shortcut.repeats):
                act(state)


def _toggle_help(state: ViewerState) -> None:
    state.is_help_open = not state.is_help_open


def _toggle_full_screen(state: ViewerState) -> None:
    state.defer(state.window.toggle_full_screen)


def _close(state: ViewerState) -> None:
    """Close the notice, the help, the full screen or the panel: the first of them that is there."""
    if state.session.message:
        state.session.message = ""
    elif state.is_help_open:
        state.is_help_open = False
    elif state.window.is_full_screen:
        _toggle_full_screen(state)
    else:
        state.toggle_panel(False)


def _seek(state: ViewerState, frame: int) -> None:
    state.session.playback.is_playing = False
    state.session.playback.seek(frame)


def _step(frames: int) -> Callable[[ViewerState], None]:
    return lambda state: state.session.playback.step(frames)


def _toggle_loop(state: ViewerState) -> None:
    playback = state.session.playback
    playback.is_looping = not playback.is_looping


def _toggle_sound(state: ViewerState) -> None:
    scene = state.session.scene
    state.sound.toggle()
    has_sound = scene is not None and scene.sound is not None
    state.session.message = f"sound {'on' if state.sound.is_on else 'off'}" if has_sound else "the scene has no sound"


def _change_speed(direction: int) -> Callable[[ViewerState], None]:
    def act(state: ViewerState) -> None:
        state.session.playback.speed = next_speed(state.session.playback.speed, direction)

    return act


def _change_camera(step: int) -> Callable[[ViewerState], None]:
    return lambda state: state.move_to_next_camera(step)


def _go_to_bookmark(index: int) -> Callable[[ViewerState], None]:
    return lambda state: state.move_to_bookmark(index)


def add_key_frame(state: ViewerState) -> None:
    """Add the view and the frame to the end of the camera path."""
    session = state.session
    if session.pose is not None:
        session.message = state.path_editor.add(session.pose, session.playback.frame)


def _next_renderer(state: ViewerState) -> None:
    name = RENDERERS[(RENDERERS.index(state.renderer.choice.name) + 1) % len(RENDERERS)]
    state.defer(lambda: state.switch_renderer(name))


def _next_comparison(state: ViewerState) -> None:
    state.compare(MODES[(MODES.index(state.comparison.mode) + 1) % len(MODES)])


def _next_style(state: ViewerState) -> None:
    names = state.session.style_names
    state.session.choose_style(names[(names.index(state.session.style_name) + 1) % len(names)])


def next_speed(speed: float, direction: int) -> float:
    """Return the next faster preset speed for direction 1, or the next slower one for direction -1.

    The result has the sign of ``speed``. If there is no such preset, it is ``speed`` itself.
    """
    presets = [value for value in SPEEDS if value > 0]
    slower = [value for value in presets if value < abs(speed) - 1e-9]
    faster = [value for value in presets if value > abs(speed) + 1e-9]
    found = faster[:1] if direction > 0 else slower[-1:]
    return math.copysign(found[0], speed) if found else speed


_Key = imgui.Key
SHORTCUTS = (
    Shortcut("Space", "play or pause", ((_Key.space, lambda state: state.session.playback.toggle()),)),
    Shortcut(
        "Left, Right",
        "previous frame, next frame",
        ((_Key.left_arrow, _step(-1)), (_Key.right_arrow, _step(1))),
        repeats=True,
    ),
    Shortcut(
        "Home, End",
        "first frame, last frame",
        (
            (_Key.home, lambda state: _seek(state, 0)),
            (_Key.end, lambda state: _seek(state, state.session.playback.frame_count - 1)),
        ),
    ),
    Shortcut(
        "[ and ]",
        "play slower, play faster",
        ((_Key.left_bracket, _change_speed(-1)), (_Key.right_bracket, _change_speed(1))),
    ),
    Shortcut("L", "loop", ((_Key.l, _toggle_loop),)),
    Shortcut("M", "sound on or off", ((_Key.m, _toggle_sound),)),
    Shortcut("N, P", "next camera, previous camera", ((_Key.n, _change_camera(1)), (_Key.p, _change_camera(-1)))),
    Shortcut("0", "initial view", ((_Key._0, lambda state: state.move_to_initial_view()),)),
    Shortcut("B", "keep this view as a bookmark", ((_Key.b, lambda state: state.add_bookmark()),)),
    Shortcut(
        "1 to 9",
        "go to a bookmark",
        tuple((getattr(_Key, f"_{number}"), _go_to_bookmark(number - 1)) for number in range(1, MAX_BOOKMARKS + 1)),
    ),
    Shortcut("K", "add this view to the camera path", ((_Key.k, lambda state: add_key_frame(state)),)),
    Shortcut("Y", "play or stop the camera path", ((_Key.y, lambda state: state.path_editor.toggle()),)),
    Shortcut("T", "next style", ((_Key.t, _next_style),)),
    Shortcut("V", "compare with the capture", ((_Key.v, _next_comparison),)),
    Shortcut("X", "measure a distance", ((_Key.x, lambda state: state.measurement.toggle()),)),
    Shortcut("R", "next renderer", ((_Key.r, _next_renderer),)),
    Shortcut(
        "I, F12",
        "save the image",
        tuple((key, lambda state: state.defer(state.take_screenshot)) for key in (_Key.i, _Key.f12)),
    ),
    Shortcut(
        "F9", "start or stop recording the camera path", ((_Key.f9, lambda state: state.defer(state.toggle_recording)),)
    ),
    Shortcut(
        "F10", "render the recorded path to MP4", ((_Key.f10, lambda state: state.defer(state.render_recorded_path)),)
    ),
    Shortcut("Tab", "show or hide the panel", ((_Key.tab, lambda state: state.toggle_panel()),), needs_scene=False),
    Shortcut(
        "F, F11",
        "full screen",
        ((_Key.f, _toggle_full_screen), (_Key.f11, _toggle_full_screen)),
        needs_scene=False,
    ),
    Shortcut(
        "?, H, F1",
        "help",
        ((_Key.slash, _toggle_help), (_Key.h, _toggle_help), (_Key.f1, _toggle_help)),
        needs_scene=False,
    ),
    Shortcut(
        "Esc", "close the notice, the help, the full screen or the panel", ((_Key.escape, _close),), needs_scene=False
    ),
    Shortcut(
        "Ctrl+O",
        "open a scene",
        ((_Key.o, lambda state: state.defer(state.choose_file)),),
        needs_scene=False,
        needs_ctrl=True,
    ),
    Shortcut("Ctrl+Q", "quit", ((_Key.q, lambda state: state.window.close()),), needs_scene=False, needs_ctrl=True),
)
"""All shortcuts, in the order of the help."""
