"""The fonts and colours of the user interface."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import imgui_bundle
from imgui_bundle import imgui

ThemeName = Literal["dark", "light"]
THEMES: tuple[ThemeName, ...] = get_args(ThemeName)

FONT_SIZE = 15.0
"""Height of text at a scale of 1, in window coordinates."""

_TEXT_FONT = Path(imgui_bundle.__file__).parent / "assets" / "fonts" / "Roboto" / "Roboto-Regular.ttf"  # Apache-2.0
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Palette:
    """The colours of a theme as red, green and blue in [0, 1].

    Attributes:
        surface: colour of the panel and the bar.
        raised: colour of buttons and fields.
        hovered: colour of a button or field under the mouse.
        line: colour of borders and separators.
        text: colour of text.
        faint: colour of less important text.
        accent: colour of the played time, of knobs and of check marks.
        start: colour behind an empty window.
    """

    surface: Colour
    raised: Colour
    hovered: Colour
    line: Colour
    text: Colour
    faint: Colour
    accent: Colour
    start: Colour


PALETTES: dict[ThemeName, Palette] = {
    "dark": Palette(
        surface=(0.11, 0.115, 0.125),
        raised=(0.18, 0.187, 0.2),
        hovered=(0.25, 0.26, 0.28),
        line=(0.22, 0.23, 0.25),
        text=(0.91, 0.92, 0.93),
        faint=(0.62, 0.64, 0.67),
        accent=(0.36, 0.62, 0.96),
        start=(0.085, 0.088, 0.095),
    ),
    "light": Palette(
        surface=(0.965, 0.967, 0.97),
        raised=(0.895, 0.9, 0.91),
        hovered=(0.83, 0.84, 0.86),
        line=(0.82, 0.83, 0.85),
        text=(0.11, 0.12, 0.14),
        faint=(0.38, 0.4, 0.44),
        accent=(0.1, 0.4, 0.82),
        start=(0.965, 0.967, 0.97),
    ),
}


def load_fonts() -> None:
    """Load the font for text, which is part of imgui-bundle.

    If a distribution has removed the file, imgui's own vector font is used.
    """
    fonts = imgui.get_io().fonts
    if _TEXT_FONT.is_file():
        fonts.add_font_from_file_ttf(str(_TEXT_FONT), FONT_SIZE)
    else:
        fonts.add_font_default_vector()


def apply_theme(name: ThemeName, scale: float) -> None:
    """Set the colours, and the sizes for text and widgets that are enlarged by ``scale``."""
    style = imgui.get_style()
    style.font_size_base = FONT_SIZE
    style.font_scale_dpi = scale
    _set_sizes(style, scale)
    _set_colours(style, PALETTES[name])


def _set_sizes(style: imgui.Style, scale: float) -> None:
    def pair(x: float, y: float) -> imgui.ImVec2:
        return imgui.ImVec2(round(scale * x), round(scale * y))

    style.window_padding = pair(14, 12)
    style.frame_padding = pair(9, 5)
    style.item_spacing = pair(8, 7)
    style.item_inner_spacing = pair(8, 4)
    style.indent_spacing = round(16 * scale)
    style.scrollbar_size = round(10 * scale)
    style.grab_min_size = round(10 * scale)
    style.window_rounding = style.popup_rounding = style.child_rounding = round(8 * scale)
    style.frame_rounding = style.grab_rounding = style.scrollbar_rounding = round(5 * scale)
    style.window_border_size = style.popup_border_size = 1.0
    style.frame_border_size = 0.0


def _set_colours(style: imgui.Style, palette: Palette) -> None:
    def set_colour(name: str, colour: Colour, alpha: float = 1.0) -> None:
        style.set_color_(getattr(imgui.Col_, name), imgui.ImVec4(*colour, alpha))

    for name in ("window_bg", "popup_bg", "title_bg", "title_bg_active", "menu_bar_bg"):
        set_colour(name, palette.surface)
    for name in ("frame_bg", "button", "header"):
        set_colour(name, palette.raised, 0.45 if name == "header" else 1)
    for name in ("frame_bg_hovered", "button_hovered", "header_hovered", "scrollbar_grab"):
        set_colour(name, palette.hovered)
    for name in (
        "frame_bg_active",
        "button_active",
        "header_active",
        "scrollbar_grab_hovered",
        "scrollbar_grab_active",
    ):
        set_colour(name, palette.hovered)
    for name in ("slider_grab", "slider_grab_active", "check_mark", "plot_histogram", "nav_cursor", "text_selected_bg"):
        set_colour(name, palette.accent, 0.4 if name == "text_selected_bg" else 1)
    for name in ("border", "separator", "separator_hovered", "separator_active"):
        set_colour(name, palette.line)
    set_colour("text", palette.text)
    set_colour("text_disabled", palette.faint)
    set_colour("scrollbar_bg", palette.surface, 0)
