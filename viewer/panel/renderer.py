"""The Renderer section: the renderer's name, the reason for the choice, and how the time per image is divided."""

from __future__ import annotations

import numpy as np
from imgui_bundle import imgui, implot

from fourd.viewer.panel.section import Section
from fourd.viewer.rendering.renderers import RENDERERS
from fourd.viewer.state import ViewerState
from fourd.viewer.timings import PARTS

_PLOT_HEIGHT = 110.0


def _draw(state: ViewerState) -> None:
    choice, renderer = state.renderer.choice, state.renderer.renderer
    changed, index = imgui.combo("renderer", RENDERERS.index(choice.name), list(RENDERERS))
    if changed:
        state.defer(lambda: state.switch_renderer(RENDERERS[index]))
    imgui.text_wrapped(choice.reason)
    if choice.name != "cpu":
        age = renderer.stale_images
        imgui.text_disabled(f"sorted in {1e3 * renderer.sort_seconds:.1f} ms, {age} image{'' if age == 1 else 's'} old")
    medians = state.timings.medians()
    has_style = state.session.settings.style is not None
    parts = [part for part in PARTS if has_style or part != "style"]
    imgui.text_wrapped(", ".join(f"{part} {medians[part]:.1f}" for part in parts) + " ms")
    _draw_plot(state, parts)


def _draw_plot(state: ViewerState, parts: list[str]) -> None:
    """Draw a stacked plot of the times of ``parts``, the parts of the work for an image, such as "draw" or "panel"."""
    tops = state.timings.cumulative()
    size = imgui.ImVec2(imgui.get_content_region_avail().x, state.text_scale * _PLOT_HEIGHT)
    bare_axis = implot.AxisFlags_.no_tick_labels | implot.AxisFlags_.no_grid_lines
    if not implot.begin_plot("##times", size, implot.Flags_.no_inputs | implot.Flags_.no_title):
        return
    implot.setup_legend(implot.Location_.north, implot.LegendFlags_.outside | implot.LegendFlags_.horizontal)
    implot.setup_axes("", "ms", bare_axis, implot.AxisFlags_.auto_fit)
    implot.setup_axis_limits(implot.ImAxis_.x1, 0, len(tops), imgui.Cond_.always)
    bottom = np.zeros(len(tops))
    positions = np.arange(len(tops), dtype=np.float64)
    for part in parts:
        top = np.ascontiguousarray(tops[:, PARTS.index(part)])
        implot.plot_shaded(part, positions, bottom, top)
        bottom = top
    implot.end_plot()


RENDERER = Section("Renderer", _draw, needs_scene=False, is_open=False)
