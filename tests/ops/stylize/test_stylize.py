"""The stylizer's kernel against its reference, and styles with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.ndimage
from numpy.typing import NDArray

from fourd.rendering.ops.stylize.op import stylize_surface
from fourd.rendering.ops.stylize.parameters import DETAILS, LINE_FILTERS, Numbers, StyleParameters, Surface, speck_reach
from fourd.rendering.ops.stylize.reference import find_lines, look_up, remove_specks, stylize_reference
from tests.stylize.surfaces import (
    line_parameters,
    make_plane,
    make_sphere,
    make_surface,
    numbers_of,
    random_surface,
    rays,
    white_table,
)


def random_parameters(rng: np.random.Generator, rows: int) -> StyleParameters:
    light = rng.normal(size=3)
    unit = {name: float(value) for name, value in zip(("angle_strength", "line_opacity"), rng.random(2), strict=True)}
    colours = ("angle_colour", "line_colour", "hatch_colour", "paper")
    numbers = Numbers(
        ray=tuple(rng.normal(size=6) / 100),  # type: ignore[arg-type]
        light=tuple(light / np.linalg.norm(light)),  # type: ignore[arg-type]
        table_alone=0.3,
        table_times_albedo=0.9,
        albedo_alone=0.2,
        detail_offset=-0.5,
        detail_per_depth=0.4,
        angle_threshold=0.4,
        depth_threshold=0.2,
        normal_threshold=0.8,
        hysteresis=0.4,
        persistence=0.6,
        hatch_levels=(0.7, 0.4),
        hatch_width=0.6,
        **unit,  # type: ignore[arg-type]
        **{name: tuple(rng.random(3)) for name in colours},  # type: ignore[arg-type]
    )
    table = rng.integers(0, 256, (rows, 256, 3)).astype(np.uint8)
    detail, lines = (str(rng.choice(names)) for names in (DETAILS, LINE_FILTERS))
    return StyleParameters(numbers, table, detail, lines, int(rng.integers(1, 9)))  # type: ignore[arg-type]


def summed_taps(state: NDArray[np.uint32]) -> NDArray[np.float32]:
    return (state & 0xFFFF0000).astype(np.uint32).view(np.float32)


def random_state(rng: np.random.Generator, surface: Surface, parameters: StyleParameters) -> NDArray[np.uint32]:
    """Random lines of a previous picture. At about 70% of the pixels, the surface has not changed since that
    picture."""
    seen = summed_taps(stylize_reference(surface, parameters).line_state) * rng.choice(
        [1, 1.5], surface.size, p=[0.7, 0.3]
    )
    bits = seen.astype(np.float32).view(np.uint32) & 0xFFFF0000
    return (bits | rng.integers(0, 256, surface.size)).astype(np.uint32)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize(("height", "width", "rows"), [(1, 1, 1), (5, 63, 2), (3, 200, 1), (37, 131, 1), (20, 64, 64)])
def test_pictures_equal_the_reference(
    simd: str, height: int, width: int, rows: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a wrong border, a wrong tap, and pixels at the end of rows that are skipped."""
    monkeypatch.setenv("FOURD_SIMD", simd)
    surface, parameters = random_surface(rng, height, width), random_parameters(rng, rows)
    state = random_state(rng, surface, parameters)
    expected = stylize_reference(surface, parameters, state)
    try:
        found = stylize_surface(surface, parameters, line_state=state, threads=2)
    except ValueError as error:
        pytest.skip(str(error))  # this machine lacks the instruction set
    # Rounding may move a tone to the next column of the random table. This column has an unrelated colour.
    differs = np.abs(found.astype(int) - expected.rgba) > 2
    assert differs.any(2).mean() < 0.02 + 2 / (height * width)
    differs = np.abs((state & 255).astype(int) - expected.lines) > 2
    assert differs.mean() < 0.02 + 1 / (height * width)
    np.testing.assert_allclose(summed_taps(state), summed_taps(expected.line_state), rtol=0.01)


def test_x_toon_with_one_row_equals_toon(rng: np.random.Generator) -> None:
    """Catches an interpolation of rows that reads another row or changes colours."""
    surface = make_sphere(64)
    row = rng.integers(0, 256, (1, 256, 3)).astype(np.uint8)
    toon = StyleParameters(numbers_of(64, table_times_albedo=1.5, albedo_alone=0.0), row)
    for rows in (2, 7, 64):
        x_toon = replace(toon, table=np.repeat(row, rows, axis=0))
        np.testing.assert_array_equal(stylize_surface(surface, toon), stylize_surface(surface, x_toon))
    tones = rng.random((4, 4)).astype(np.float32)
    np.testing.assert_array_equal(look_up(row, tones, tones), look_up(np.repeat(row, 2, 0), tones, tones))


@pytest.mark.parametrize("lines", ["sobel", "cross"])
@pytest.mark.parametrize("normal", [(0, 0, -1), (0.4, 0.2, -1), (-0.8, 0.5, -0.6)])
def test_a_plane_has_no_edge(lines: str, normal: tuple[float, float, float]) -> None:
    """Catches lines at the border of the picture, and on slopes that are below the threshold."""
    surface = make_plane(96, normal)
    parameters = line_parameters(96, depth_threshold=0.1, lines=lines, thickness=2)
    np.testing.assert_array_equal(stylize_surface(surface, parameters)[..., :3], surface.albedo[..., :3])
    assert not find_lines(surface, parameters).any()


def test_the_cross_filter_ignores_slopes() -> None:
    """Catches a cross filter that uses first instead of second differences. The first differences of a steep plane
    exceed any threshold."""
    surface = make_plane(96, (0.97, 0, -0.3))
    sensitive = line_parameters(96, depth_threshold=1e-4, lines="cross")
    assert not stylize_surface(surface, sensitive, line_state=np.zeros((96, 96), np.uint32))[..., 0].min() < 150
    assert find_lines(surface, replace(sensitive, lines="sobel")).mean() > 0.9


@pytest.mark.parametrize("threshold", [0.3, 0.5, 0.8])
def test_the_dark_ring_of_a_sphere_has_the_radius_of_the_threshold(threshold: float) -> None:
    """Catches a surface angle that is measured from the viewing axis instead of the ray, and a squared cosine."""
    size, distance = 200, 3.0
    numbers = numbers_of(size, angle_threshold=threshold, angle_softness=1e-4, angle_strength=1.0)
    picture = stylize_surface(make_sphere(size, 1.0, distance), StyleParameters(numbers, white_table()))
    bright = picture[..., 0] > 100
    # On the ring, N.V = c. By the law of sines, the angle a at the camera has sin(a) = sin(acos(c)) / distance, because
    # the radius is 1.
    sine = np.sqrt(1 - threshold**2) / distance
    expected = 200.0 * sine / np.sqrt(1 - sine**2)
    found = np.sqrt(bright.sum() / np.pi)
    assert found == pytest.approx(expected, abs=0.8)


def test_sobel_lines_turn_with_the_picture(rng: np.random.Generator) -> None:
    """Catches a transposed kernel, and weights that differ between rows and columns."""
    surface = random_surface(rng, 48, 48)
    parameters = line_parameters(48, depth_threshold=0.3, normal_threshold=0.9)
    normal = np.maximum(surface.normal, 1)  # so that each component can be negated
    surface = replace(surface, normal=normal)
    turned_normal = np.stack([normal[..., 1], 256 - normal[..., 0].astype(int), normal[..., 2], normal[..., 3]], 2)
    parts = (surface.albedo, surface.inverse_depth, turned_normal.astype(np.uint8))
    turned = Surface(*(np.ascontiguousarray(np.rot90(part)) for part in parts))
    # The normals keep their axes, because lines depend only on the angles between normals.
    states = [np.zeros((48, 48), np.uint32) for _ in range(2)]
    stylize_surface(surface, parameters, line_state=states[0])
    stylize_surface(turned, parameters, line_state=states[1])
    assert states[0].any()
    strengths = [(state & 255).astype(int) for state in states]
    np.testing.assert_allclose(np.rot90(strengths[0]), strengths[1], atol=1)


@pytest.mark.parametrize(("jump", "is_drawn"), [(0.03, False), (0.08, True)])
def test_a_step_is_drawn_above_the_threshold(jump: float, is_drawn: bool) -> None:
    """Catches a threshold that is not relative to the depth, or that is scaled by the weights of the filter."""
    for distance in (1.0, 50.0):
        depth = np.full((40, 40), distance)
        depth[:, 20:] /= 1 - jump
        surface = make_surface(depth, np.broadcast_to([0.0, 0, -1], (40, 40, 3)))
        lines = find_lines(surface, line_parameters(40, depth_threshold=0.05))
        assert lines.any() == is_drawn
        columns = np.flatnonzero(lines.any(0))
        assert not is_drawn or list(columns) == [19, 20]


def test_ramps_below_the_threshold_draw_nothing() -> None:
    """Catches a filter that accumulates the slope of a plane over the picture."""
    depth = 1 / np.broadcast_to(np.linspace(0.5, 1, 200), (40, 200))
    surface = make_surface(depth, np.broadcast_to([0.0, 0, -1], (40, 200, 3)))
    slope = 2 * (0.5 / 199) / 0.5  # largest relative jump between the taps
    assert not find_lines(surface, line_parameters(40, depth_threshold=1.01 * slope)).any()
    assert find_lines(surface, line_parameters(40, depth_threshold=0.5 * slope)).any()


def test_outlines_are_closed() -> None:
    """Catches outlines with gaps. Every path from the middle of a sphere to the border of the image must cross a
    line."""
    surface = make_sphere(160)
    lines = find_lines(surface, line_parameters(160, depth_threshold=0.05)) > 0.5
    distance = np.hypot(*(np.mgrid[:160, :160] - 79.5))
    seen = np.isfinite(surface.depth)
    outside, _ = scipy.ndimage.label(~lines)
    assert outside[0, 0] != outside[80, 80]
    assert lines.any()
    assert distance[lines].min() > distance[seen].max() - 3


@pytest.mark.parametrize("lines", ["sobel", "cross"])
def test_backs_of_surfaces_have_no_lines_inside(lines: str) -> None:
    """Catches speckle and missing outlines at holes between points, through which the back of a surface is visible."""
    depth = np.full((60, 60), np.inf)
    depth[10:50, 10:50] = 3.0
    depth[25:35, 25:35] = 3.6
    towards = np.broadcast_to([0.0, 0.0, -1.0], (60, 60, 3)).copy()
    parameters = line_parameters(60, depth_threshold=0.05, normal_threshold=10.0, lines=lines)
    step = find_lines(make_surface(depth, towards), parameters)
    assert step[23:37, 23:37].max() == 1
    towards[25:35, 25:35, 2] = 1
    hole = find_lines(make_surface(depth, towards), parameters)
    assert hole[20:40, 20:40].max() == 0
    towards[..., 2] = 1
    back = find_lines(make_surface(depth, towards), parameters)
    outline = np.zeros((60, 60), bool)
    outline[9:51, 9:51] = True
    outline[12:48, 12:48] = False
    np.testing.assert_array_equal(back[outline], step[outline])


def test_a_line_stays_until_it_is_clearly_below_the_threshold() -> None:
    """Catches lines that flicker when a jump moves around the threshold."""
    surface = make_sphere(160)
    parameters = line_parameters(160, depth_threshold=1.6, normal_threshold=1.6, hysteresis=0.7)
    kept = find_lines(surface, parameters, np.full((160, 160), 255, np.uint32))
    assert kept.any()
    assert not find_lines(surface, parameters, np.zeros((160, 160), np.uint32)).any()


def test_lines_fade_in_where_the_surface_rests() -> None:
    """Catches lines that reach full strength in one picture although the surface does not move, and lines that fade in
    where the surface moves.
    """
    surface, still = make_sphere(160), np.zeros((160, 160), np.uint32)
    parameters = line_parameters(160, persistence=0.75)
    stylize_surface(surface, parameters, line_state=still)
    assert (still & 255).max() == 255  # the lines of the first picture from a camera have full strength
    still &= 0xFFFF0000
    strengths = []
    for _ in range(3):
        stylize_surface(surface, parameters, line_state=still)
        strengths.append(int((still & 255).max()))
    np.testing.assert_allclose(strengths, [255 * (1 - 0.75**count) for count in (1, 2, 3)], atol=2)


def test_lines_vanish_at_once() -> None:
    """Catches lines that remain at pixels where the surface has disappeared or has become flat."""
    flat = make_surface(np.full((40, 40), 2.0), np.broadcast_to([0.0, 0, -1], (40, 40, 3)))
    for surface in (flat, Surface.empty(40, 40)):
        state = np.zeros((40, 40), np.uint32)
        stylize_surface(surface, line_parameters(40), line_state=state)
        state |= 255
        stylize_surface(surface, line_parameters(40, persistence=0.9), line_state=state)
        assert not (state & 255).any()


@pytest.mark.parametrize("thickness", [1, 3, 8])
def test_specks_are_removed_and_lines_stay(thickness: int) -> None:
    """Catches specks that are kept because other specks are near, and lines that are shortened or interrupted."""
    size, reach = 200, speck_reach(thickness)
    specks = np.zeros((size, size), np.uint8)
    specks[20 : 20 + reach, 60 : 60 + reach // 2] = 255
    for column in range(20, 180, reach):
        specks[150, column : column + reach // 2] = 255
    assert not remove_specks(specks, reach).any()
    lines = np.zeros((size, size), np.uint8)
    lines[100, 10:190] = lines[:, 63] = lines[np.arange(size), np.arange(size)] = 255
    np.testing.assert_array_equal(remove_specks(lines, reach), lines)


@pytest.mark.parametrize("threads", [1, 4])
def test_specks_of_a_surface_are_not_drawn(threads: int) -> None:
    """Catches specks in the picture, and lines with gaps where two runs of 64 pixels or the rows of two tasks meet."""
    depth = np.full((200, 200), 3.0)
    depth[:, 120:] = 2.0
    depth[60:63, 62:65] = 2.0
    surface = make_surface(depth, np.broadcast_to([0.0, 0, -1], (200, 200, 3)))
    state = np.zeros((200, 200), np.uint32)
    picture = stylize_surface(surface, line_parameters(200), line_state=state, threads=threads)
    assert (state[58:66, 58:66] & 255).any()  # the filter finds the speck
    is_dark = picture[..., :3].max(2) == 0
    assert set(np.flatnonzero(is_dark.any(0))) == {119, 120}
    assert is_dark[:, 119:121].all()


def test_gaps_between_points_are_filled() -> None:
    """Catches isolated line pixels where a few pixels show a farther surface through a gap between points."""
    depth = np.full((40, 40), 2.0)
    depth[10:12, 10:13], depth[30, :] = 5.0, 3.0
    surface = make_surface(depth, np.broadcast_to([0.0, 0, -1], (40, 40, 3)))
    assert not find_lines_of_picture(surface).any()


def find_lines_of_picture(surface: Surface) -> np.ndarray:
    state = np.zeros(surface.size, np.uint32)
    stylize_surface(surface, line_parameters(surface.size[0]), line_state=state)
    return state & 255


def test_shading_follows_the_light() -> None:
    """Catches light from the wrong direction. The lit side of a sphere must be bright, and the opposite side must be
    dark.
    """
    table = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, 2)
    numbers = replace(numbers_of(64, table_alone=1.0, albedo_alone=0.0), light=(-1.0, 0.0, 0.0))
    picture = stylize_surface(make_sphere(64), StyleParameters(numbers, table))[..., 0]
    sphere = make_sphere(64)
    expected = 127.5 * (1 - sphere.unit_normal[..., 0])
    seen = np.isfinite(sphere.depth)
    np.testing.assert_allclose(picture[seen], expected[seen], atol=1.6)
    assert rays(4).shape == (4, 4, 3)


def test_invalid_parameters_are_refused() -> None:
    """Catches divisions by a threshold of 0, parameters that are not finite, and surfaces of the wrong size."""
    surface, good = make_sphere(16), line_parameters(16)
    for changes, message in (
        ({"depth_threshold": 0.0}, "depth_threshold, normal_threshold: expected more than 0"),
        ({"persistence": 1.0}, "hysteresis, persistence: expected numbers from 0 to below 1"),
        ({"line_opacity": float("nan")}, "numbers: expected finite numbers"),
        ({"hatch_spacing": 0.5}, "hatch_spacing: expected at least 1 pixel"),
    ):
        with pytest.raises(ValueError, match=message):
            stylize_surface(surface, replace(good, numbers=replace(good.numbers, **changes)))
    with pytest.raises(ValueError, match="thickness: expected 1 to 8 pixels"):
        stylize_surface(surface, replace(good, thickness=9))
    with pytest.raises(ValueError, match="expected the size of albedo"):
        stylize_surface(surface, good, out=np.empty((8, 16, 4), np.uint8))
