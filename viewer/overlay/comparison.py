"""Draws the captured picture or another scene under the user interface: beside the scene, or on the left of a line."""

from __future__ import annotations

from imgui_bundle import imgui

from fourd.viewer.comparison.comparison import ShownPicture
from fourd.viewer.comparison.other_scene import OtherScene
from fourd.viewer.comparison.placement import area_of_picture, fitted
from fourd.viewer.interface.layout import Area
from fourd.viewer.overlay.label import corners, draw_label
from fourd.viewer.state import ViewerState

_GRIP_WIDTH, _KNOB_RADIUS = 24.0, 9.0
"""Width of the strip in which the mouse moves the line, and radius of the knob in its middle, at a text scale of 1."""
_FLAGS = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_background
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_bring_to_front_on_focus
    | imgui.WindowFlags_.no_nav
)


def draw_comparison(state: ViewerState) -> None:
    """Draw the captured picture, if the user compares the scene with it."""
    comparison, session = state.comparison, state.session
    if not comparison.is_on or session.scene is None:
        return
    session.message = comparison.take_error() or session.message
    if not comparison.is_on:  # the other scene could not be opened
        return
    if comparison.other is not None:
        _draw_other(state, comparison.other)
        return
    seen = state.compared_camera
    if comparison.mode == "side by side":
        camera = state.camera_index if seen is None else seen
        _draw_beside(state, comparison.picture(camera, session.playback.frame), is_aligned=seen is not None)
    elif seen is None and not session.is_moving:
        draw_label(state.text_scale, state.layout.free, "press N or P to compare the view of a camera")
    elif seen is not None:
        _draw_wipe(state, comparison.picture(seen, session.playback.frame))


def _draw_beside(state: ViewerState, picture: ShownPicture | None, *, is_aligned: bool) -> None:
    """Draw the picture in the left half of the free area. ``is_aligned`` says that its camera shows the scene."""
    left, right = state.layout.free.split(0.5)
    _fill(state, left)
    if picture is not None:
        placed = _place(state, picture).moved(left.left - right.left) if is_aligned else fitted(picture.size, left)
        _draw_picture(picture, placed, left)
        draw_label(state.text_scale, left, _title(state, picture))
    draw_label(state.text_scale, right, "rendered")


def _draw_wipe(state: ViewerState, picture: ShownPicture | None) -> None:
    """Draw the picture on the left of the line, exactly over the scene, and the line."""
    free = state.layout.free
    left, right = free.split(state.comparison.share)
    if picture is not None:
        _fill(state, left)
        _draw_picture(picture, _place(state, picture), left)
        draw_label(state.text_scale, left, _title(state, picture))
    draw_label(state.text_scale, right, "rendered", is_at_right=True)
    _draw_line(state, free, right.left)


def _draw_other(state: ViewerState, other: OtherScene) -> None:
    """Draw the other scene in the left half of the free area, or on the left of the line."""
    free, is_beside = state.layout.free, state.comparison.mode == "side by side"
    left, right = free.split(0.5 if is_beside else state.comparison.share)
    _fill(state, left)
    drawing, texture = imgui.get_background_draw_list(), other.texture
    if texture is not None:
        window = Area(0, 0, *state.window.size)
        drawing.push_clip_rect(*corners(left), True)
        # Row 0 of the texture is at the bottom.
        drawing.add_image(imgui.ImTextureRef(texture), *corners(window), imgui.ImVec2(0, 1), imgui.ImVec2(1, 0))
        drawing.pop_clip_rect()
    scene = state.session.scene
    draw_label(state.text_scale, left, other.path.name)
    draw_label(state.text_scale, right, "" if scene is None else scene.path.name, is_at_right=not is_beside)
    if not is_beside:
        _draw_line(state, free, right.left)


def _place(state: ViewerState, picture: ShownPicture) -> Area:
    """Return the area of the picture in window coordinates, over the scene that is drawn from its camera."""
    scene, pose = state.session.scene, state.session.pose
    assert scene is not None
    assert pose is not None
    shown = pose.camera(*state.window.framebuffer_size, state.picture_shift)
    return area_of_picture(scene.manifest.cameras[picture.camera], shown).scaled(1 / state.pixels_per_unit)


def _title(state: ViewerState, picture: ShownPicture) -> str:
    scene = state.session.scene
    return "captured" if scene is None else f"camera {scene.manifest.names[picture.camera]}, captured"


def _draw_picture(picture: ShownPicture, area: Area, room: Area) -> None:
    drawing = imgui.get_background_draw_list()
    drawing.push_clip_rect(*corners(room), True)
    drawing.add_image(imgui.ImTextureRef(picture.texture), *corners(area))
    drawing.pop_clip_rect()


def _fill(state: ViewerState, area: Area) -> None:
    colour = imgui.color_convert_float4_to_u32(imgui.ImVec4(*state.session.settings.colour_behind, 1))
    imgui.get_background_draw_list().add_rect_filled(*corners(area), colour)


def _draw_line(state: ViewerState, free: Area, x: float) -> None:
    """Draw the line with its knob, and move it with the mouse."""
    scale, width = state.text_scale, _GRIP_WIDTH * state.text_scale
    imgui.set_next_window_pos(imgui.ImVec2(x - width / 2, free.top))
    imgui.set_next_window_size(imgui.ImVec2(width, free.height))
    imgui.push_style_var(imgui.StyleVar_.window_padding, imgui.ImVec2(0, 0))
    imgui.push_style_var(imgui.StyleVar_.window_min_size, imgui.ImVec2(1, 1))
    imgui.begin("##line", None, _FLAGS)
    imgui.invisible_button("##grip", imgui.ImVec2(width, free.height))
    if imgui.is_item_active():
        share = (imgui.get_mouse_pos().x - free.left) / free.width
        state.comparison.share = min(max(share, 0.0), 1.0)
    if imgui.is_item_active() or imgui.is_item_hovered():
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    imgui.end()
    imgui.pop_style_var(2)
    drawing, white, black = imgui.get_background_draw_list(), imgui.IM_COL32(*[255] * 4), imgui.IM_COL32(0, 0, 0, 255)
    top, bottom = imgui.ImVec2(x, free.top), imgui.ImVec2(x, free.top + free.height)
    drawing.add_line(top, bottom, black, 3 * scale)
    drawing.add_line(top, bottom, white, 1.5 * scale)
    middle = imgui.ImVec2(x, free.centre[1])
    drawing.add_circle_filled(middle, _KNOB_RADIUS * scale, white)
    drawing.add_circle(middle, _KNOB_RADIUS * scale, black, 0, scale)
