"""The panel: everything that can be set, and what goes on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import imgui, implot

from fourd.viewer.controls import HELP
from fourd.viewer.display import LARGEST_SCALE, SMALLEST_SCALE
from fourd.viewer.navigation.pose import NARROWEST, WIDEST
from fourd.viewer.rendering.renderers import RENDERERS
from fourd.viewer.timings import PARTS

if TYPE_CHECKING:
    from fourd.viewer.app import App, Rendering

_WIDTH = 320.0
_MARGIN = 10.0
_SPINNER = "|/-\\"
_MOST_LAYERS = 64


def draw_panel(app: App) -> None:
    """The panel, the message line and the spinner."""
    _keys(app)
    scale = _scale(app)
    imgui.get_style().font_scale_dpi = scale
    if app.panel_open:
        imgui.set_next_window_pos(imgui.ImVec2(_MARGIN, _MARGIN), imgui.Cond_.first_use_ever)
        height, width = max(app.window.size[1] - 2 * _MARGIN, 100.0), scale * _WIDTH
        imgui.set_next_window_size_constraints(imgui.ImVec2(width, 60), imgui.ImVec2(2 * width, height))
        imgui.begin("fourd", None, imgui.WindowFlags_.always_auto_resize)
        imgui.push_item_width(-110 * scale)
        _scene(app)
        if app.session.scene is not None:
            _playback(app)
            _viewpoint(app)
            _look(app)
            _pictures(app)
        _renderer(app)
        _help()
        imgui.pop_item_width()
        imgui.end()
    _notices(app)


def draw_progress(app: App, rendering: Rendering) -> None:
    """Instead of the panel, while a video is being made."""
    width, height = app.window.size
    imgui.set_next_window_pos(imgui.ImVec2(width / 2, height / 2), imgui.Cond_.always, imgui.ImVec2(0.5, 0.5))
    imgui.begin("rendering", None, imgui.WindowFlags_.always_auto_resize)
    imgui.text(str(rendering.path))
    share = rendering.done / rendering.count
    imgui.progress_bar(share, imgui.ImVec2(_WIDTH, 0), f"{rendering.done} of {rendering.count} pictures")
    if imgui.button("Stop") or imgui.is_key_pressed(imgui.Key.escape, False):
        app.stop_rendering()
    imgui.end()


def _keys(app: App) -> None:
    if imgui.get_io().want_text_input:
        return
    if imgui.is_key_pressed(imgui.Key.tab, False):
        app.panel_open = not app.panel_open
    if imgui.is_key_pressed(imgui.Key.f12, False):
        app.later(app.screenshot)
    scene = app.session.scene
    if scene is None:
        return
    if imgui.is_key_pressed(imgui.Key.r, False):
        following = RENDERERS[(RENDERERS.index(app.chosen.name) + 1) % len(RENDERERS)]
        app.later(lambda: app.use(following))
    if imgui.is_key_pressed(imgui.Key.f9, False):
        app.later(app.toggle_recording)
    if imgui.is_key_pressed(imgui.Key.f10, False):
        app.later(app.render_flight)
    if imgui.is_key_pressed(imgui.Key._0, False):
        app.session.glide_to(scene.start(app.window.framebuffer_size))
    for key, on in ((imgui.Key.n, 1), (imgui.Key.p, -1)):
        if imgui.is_key_pressed(key, False) and scene.manifest.cameras:
            app.camera_index = (app.camera_index + on) % len(scene.manifest.cameras)
            app.camera_pose(app.camera_index)


def _scene(app: App) -> None:
    scene = app.session.scene
    if scene is None:
        imgui.text_wrapped("Drop a .4dv file or a run's folder on this window.")
        return
    imgui.text_wrapped(scene.path.name)
    points, background = scene.manifest.points, scene.manifest.background
    many = f", {max(points):,} points" if points else ""
    imgui.text_disabled(f"{scene.manifest.frame_count} frames{many}, {scene.manifest.view_count} source views")
    if background is not None:
        imgui.text_disabled(f"background: {background.points:,} points")
    if scene.checkpoint:
        imgui.text_disabled(f"training: {scene.checkpoint}")


def _playback(app: App) -> None:
    playback = app.session.playback
    if not _section("Playback"):
        return
    if imgui.button("Pause" if playback.playing else "Play"):
        playback.toggle()
    imgui.same_line()
    if imgui.button("<"):
        playback.step(-1)
    imgui.same_line()
    if imgui.button(">"):
        playback.step(1)
    imgui.same_line()
    _, playback.looping = imgui.checkbox("loop", playback.looping)
    changed, frame = imgui.slider_int("frame", playback.frame, 0, playback.frames - 1)
    if changed:
        playback.seek(frame)
    _, playback.speed = imgui.slider_float("speed", playback.speed, -4.0, 4.0, "%.2f x")
    assert app.session.scene is not None
    imgui.text_disabled(
        f"{playback.fps * playback.speed:.3g} frames a second, {app.session.scene.stream.ahead} read ahead"
    )


def _viewpoint(app: App) -> None:
    session = app.session
    assert session.scene is not None
    if session.pose is None or not _section("Viewpoint"):
        return
    manifest = session.scene.manifest
    if manifest.cameras:
        app.camera_index = min(app.camera_index, len(manifest.cameras) - 1)
        changed, index = imgui.combo("camera", app.camera_index, list(manifest.names))
        if changed:
            app.camera_index = index
            app.camera_pose(index)
    changed, degrees = imgui.slider_float(
        "field of view",
        float(np.degrees(session.pose.field_of_view)),
        float(np.degrees(NARROWEST)),
        float(np.degrees(WIDEST)),
        "%.1f deg",
    )
    if changed:
        session.move(session.pose.widened(float(np.radians(degrees))))
    if imgui.button("First view"):
        session.glide_to(session.scene.start(app.window.framebuffer_size))


def _look(app: App) -> None:
    session = app.session
    if not _section("DisplaySettings"):
        return
    settings = session.settings
    changed, layers = imgui.slider_int("layers K", settings.layers, 1, _MOST_LAYERS)
    if changed:
        session.choose_layers(layers)
    logarithmic = imgui.SliderFlags_.logarithmic
    changed, scale = imgui.slider_float(
        "point size", settings.point_scale, SMALLEST_SCALE, LARGEST_SCALE, "%.2f x", logarithmic
    )
    if changed:
        session.settings = replace(session.settings, point_scale=scale)
    changed, scale = imgui.slider_float(
        "density", settings.density_scale, SMALLEST_SCALE, LARGEST_SCALE, "%.2f x", logarithmic
    )
    if changed:
        session.settings = replace(session.settings, density_scale=scale)
    changed, colour = imgui.color_edit3("background", list(settings.background))
    if changed:
        red, green, blue = (min(max(float(value), 0.0), 1.0) for value in colour)
        session.settings = replace(session.settings, background=(red, green, blue))


def _pictures(app: App) -> None:
    if not _section("Pictures"):
        return
    if imgui.button("Screenshot"):
        app.later(app.screenshot)
    recorder = app.recorder
    if imgui.button("Record path" if recorder is None else f"Stop ({recorder.seconds:.1f} s)"):
        app.later(app.toggle_recording)
    if app.flight is not None:
        imgui.same_line()
        if imgui.button(f"Render {len(app.flight.stops)} pictures to MP4"):
            app.later(app.render_flight)


def _renderer(app: App) -> None:
    if not _section("Renderer"):
        return
    changed, index = imgui.combo("renderer", RENDERERS.index(app.chosen.name), list(RENDERERS))
    if changed:
        app.later(lambda: app.use(RENDERERS[index]))
    imgui.text_wrapped(app.chosen.reason)
    if app.chosen.name != "cpu":
        age = app.renderer.behind
        imgui.text_disabled(
            f"sorted in {1e3 * app.renderer.sort_seconds:.1f} ms, {age} picture{'' if age == 1 else 's'} old"
        )
    medians = app.timings.medians()
    imgui.text(", ".join(f"{name} {medians[name]:.1f}" for name in PARTS) + " ms")
    _plot(app)


def _plot(app: App) -> None:
    sums = app.timings.sums()
    scale = _scale(app)
    size = imgui.ImVec2(scale * (_WIDTH - 20), scale * 110)
    plain = implot.AxisFlags_.no_tick_labels | implot.AxisFlags_.no_grid_lines
    if not implot.begin_plot("##times", size, implot.Flags_.no_inputs | implot.Flags_.no_title):
        return
    implot.setup_legend(implot.Location_.north, implot.LegendFlags_.outside | implot.LegendFlags_.horizontal)
    implot.setup_axes("", "ms", plain, implot.AxisFlags_.auto_fit)
    implot.setup_axis_limits(implot.ImAxis_.x1, 0, len(sums), imgui.Cond_.always)
    below = np.zeros(len(sums))
    places = np.arange(len(sums), dtype=np.float64)
    for column, name in enumerate(PARTS):
        top = np.ascontiguousarray(sums[:, column])
        implot.plot_shaded(name, places, below, top)
        below = top
    implot.end_plot()


def _help() -> None:
    if not _section("Controls", open_at_first=False):
        return
    for keys, what in HELP:
        imgui.bullet_text(f"{keys}: {what}")


def _notices(app: App) -> None:
    """The message line, and the spinner while something is being read."""
    session = app.session
    width, height = app.window.size
    bare = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_nav
    if session.opening or session.waiting:
        imgui.set_next_window_pos(imgui.ImVec2(width / 2, height / 2), imgui.Cond_.always, imgui.ImVec2(0.5, 0.5))
        imgui.begin("##spinner", None, bare | imgui.WindowFlags_.no_inputs)
        turn = _SPINNER[int(8 * imgui.get_time()) % len(_SPINNER)]
        imgui.text(f"{turn} {'opening' if session.opening else 'reading a frame'}")
        imgui.end()
    if session.message:
        imgui.set_next_window_pos(imgui.ImVec2(width / 2, height - _MARGIN), imgui.Cond_.always, imgui.ImVec2(0.5, 1.0))
        imgui.set_next_window_size_constraints(imgui.ImVec2(0, 0), imgui.ImVec2(max(width - 2 * _MARGIN, 50), height))
        imgui.begin("##message", None, bare)
        imgui.push_text_wrap_pos(max(width - 6 * _MARGIN - 80, 40))
        imgui.text(session.message)
        imgui.pop_text_wrap_pos()
        imgui.same_line()
        if imgui.small_button("Close"):
            session.message = ""
        imgui.end()


def _section(title: str, open_at_first: bool = True) -> bool:
    flags = imgui.TreeNodeFlags_.default_open if open_at_first else 0
    return imgui.collapsing_header(title, flags)


def _scale(app: App) -> float:
    """Of text: what the system asks for, where its units are pixels; elsewhere the framebuffer is larger already."""
    larger = app.window.framebuffer_size[0] > app.window.size[0]
    return 1.0 if larger else app.window.scale
