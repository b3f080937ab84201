"""Tests of each stereo stage, from patch similarity to points, on known surfaces."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from fourd.base.cameras import Camera, look_at
from fourd.reconstruction.background.surfaces.completion import complete_surfaces
from fourd.reconstruction.background.surfaces.enclosing_planes import EnclosingPlanes
from fourd.reconstruction.background.surfaces.guidance import complete_with_guidance
from fourd.reconstruction.background.surfaces.surface_sampling import sample_surfaces
from fourd.recording.stereo.fusion import Surface, fuse_depth_maps
from fourd.recording.stereo.patches import GreyView, Grid, PatchSimilarity, index_intrinsics
from fourd.recording.stereo.patchmatch import DepthMap
from fourd.recording.stereo.plane_hypotheses import PLANE_TOLERANCE, find_large_planes, plane_in_view, triangle_planes
from fourd.recording.stereo.source_selection import select_sources

WIDTH, HEIGHT = 96, 72
FLOOR = np.array([0.0, 0.0, 1.0, 0.0])
INTRINSICS = np.array([[90.0, 0, 48], [0, 90, 36], [0, 0, 1]])


def camera(x: float, y: float = 0.0, z: float = 2.0) -> Camera:
    """A camera that looks at the floor's centre."""
    return look_at(np.array([x, y, z]), np.zeros(3), np.array([0.0, 1.0, 0.1]), INTRINSICS, WIDTH, HEIGHT)


CAMERAS = [camera(-0.5), camera(0.0), camera(0.5)]
WHOLE = [np.ones((HEIGHT, WIDTH), bool)]


def floor_map(view: Camera) -> DepthMap:
    """A depth map of the floor z = 0 with high scores."""
    grid = Grid.covering(WIDTH, HEIGHT, 2)
    return DepthMap(grid, plane_in_view(FLOOR, view, grid).copy(), np.full(len(grid.pixels), 0.9, np.float32))


def surface_of(view: Camera, known: np.ndarray) -> Surface:
    return Surface(view, floor_map(view), known, known.astype(np.intp))


def textured(view: Camera, rng: np.random.Generator) -> np.ndarray:
    """Image (H, W, 3) of a floor with a random texture. Equal states of the random generator give equal images."""
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (400, 400)).astype(np.float32), (0, 0), 4)
    texture = cv2.normalize(texture, np.zeros_like(texture), 0, 255, cv2.NORM_MINMAX)
    to_texture = np.array([[100.0, 0, 200], [0, 100, 200], [0, 0, 1]])
    to_pixel = index_intrinsics(view) @ np.column_stack([view.rotation[:, :2], view.translation])
    grey = cv2.warpPerspective(texture, to_pixel @ np.linalg.inv(to_texture), (WIDTH, HEIGHT))
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def test_the_true_plane_has_the_highest_score() -> None:
    """Catches half-pixel and sign errors between two images. With a half-pixel or sign error, a wrong plane has a
    higher score."""
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    views = [GreyView.from_rgb(view, textured(view, np.random.default_rng(5)), everywhere) for view in CAMERAS]
    grid = Grid.covering(WIDTH, HEIGHT, 4)
    likeness = PatchSimilarity(views[1], (views[0], views[2]), grid)
    cells = np.flatnonzero(likeness.usable)
    true = plane_in_view(FLOOR, CAMERAS[1], grid)[cells]
    scores = likeness.scores(cells, true)
    assert np.median(scores) > 0.99
    for share in (0.97, 1.03):
        assert (likeness.scores(cells, np.float32(share) * true) < scores).mean() > 0.9


def test_windows_in_holes_are_ignored() -> None:
    """Catches correlations that include the fill colour of a hole."""
    seen = np.ones((HEIGHT, WIDTH), bool)
    seen[4:68, 4:92] = False
    rgb = textured(CAMERAS[1], np.random.default_rng(5))
    holed = GreyView.from_rgb(CAMERAS[1], rgb, seen)
    whole = GreyView.from_rgb(CAMERAS[0], textured(CAMERAS[0], np.random.default_rng(5)), np.ones_like(seen))
    grid = Grid.covering(WIDTH, HEIGHT, 4)
    middle = np.flatnonzero((np.abs(grid.pixels[:, 0] - 50) < 4) & (np.abs(grid.pixels[:, 1] - 35) < 4))
    assert not PatchSimilarity(holed, (whole,), grid).usable[middle].any()
    scores = PatchSimilarity(whole, (holed,), grid).scores(middle, plane_in_view(FLOOR, CAMERAS[0], grid)[middle])
    assert (scores == -1).all()


def test_planes_behind_the_source_have_no_score() -> None:
    """Catches windows that are behind a camera but count as visible in its image."""
    views = [
        GreyView.from_rgb(view, textured(view, np.random.default_rng(5)), np.ones((HEIGHT, WIDTH), bool))
        for view in (
            CAMERAS[1],
            look_at(np.array([0.0, 0, 2.0]), np.array([0.0, 0, 9.0]), np.array([0.0, 1, 0]), INTRINSICS, WIDTH, HEIGHT),
        )
    ]
    grid = Grid.covering(WIDTH, HEIGHT, 8)
    cells = np.arange(len(grid.pixels))
    assert (
        PatchSimilarity(views[0], views[1:], grid).scores(cells, plane_in_view(FLOOR, CAMERAS[1], grid)) == -1
    ).all()


def test_contradicted_cells_are_dropped() -> None:
    """Catches depth errors of a single depth map that are kept as points in free space."""
    maps = [floor_map(view) for view in CAMERAS]
    wrong = (np.abs(maps[1].grid.pixels[:, 0] - 48) < 12) & (np.abs(maps[1].grid.pixels[:, 1] - 36) < 12)
    planes = maps[1].planes.copy()
    planes[wrong] *= 1.5
    found = fuse_depth_maps(CAMERAS, [maps[0], replace(maps[1], planes=planes), maps[2]])
    assert not found[1].known[wrong].any()
    assert found[1].known[~wrong].mean() > 0.8
    assert found[0].known.mean() > 0.7
    assert np.abs(found[1].points(np.flatnonzero(found[1].known))[:, 2]).max() < 1e-3


def test_one_confirming_picture_is_needed_and_enough() -> None:
    """Catches the removal of walls that only two cameras see, and unconfirmed cells that are kept."""
    left, right = camera(-0.9), camera(0.9)
    found = fuse_depth_maps([left, right], [floor_map(left), floor_map(right)])
    pixels, depth = right.project(found[0].points(np.arange(len(found[0].known))))
    own = found[0].depths.grid.pixels[:, :2]
    shared = (depth > 0) & np.logical_and.reduce(
        [(at > 4).all(axis=1) & (at < (WIDTH - 4, HEIGHT - 4)).all(axis=1) for at in (pixels, own)]
    )
    outside = (pixels < -2).any(axis=1) | (pixels > (WIDTH + 2, HEIGHT + 2)).any(axis=1)
    assert found[0].known[shared].all()
    assert not found[0].known[outside].any()
    assert (found[0].support[shared] == 1).all()


def test_small_components_are_dropped() -> None:
    """Catches small groups of cells that are kept because they are consistent by chance, and that distort the depth
    completion."""
    maps = [floor_map(view) for view in CAMERAS]
    numbers = np.arange(len(maps[0].scores)).reshape(maps[0].grid.shape)
    kept = np.zeros(len(maps[0].scores), bool)
    kept[numbers[4:8, 4:8]] = True
    kept[numbers[20:30, 20:30]] = True
    maps[1] = replace(maps[1], scores=np.where(kept, 0.9, 0).astype(np.float32))
    found = fuse_depth_maps(CAMERAS, maps)[1].known
    assert not found[numbers[4:8, 4:8]].any()
    assert found[numbers[20:30, 20:30]].all()


def test_completion_of_a_floor_is_planar() -> None:
    """Catches interpolation of depths instead of inverse depths, which bends planes."""
    grid = Grid.covering(WIDTH, HEIGHT, 2)
    gap = (np.abs(grid.pixels[:, 0] - 48) < 20) & (np.abs(grid.pixels[:, 1] - 36) < 16)
    surfaces = [surface_of(view, ~gap) for view in (camera(-0.5), camera(-0.45))]
    for surface in surfaces:
        surface.depths.planes[gap] = 0
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    views = [GreyView.from_rgb(surface.camera, grey, np.ones((HEIGHT, WIDTH), bool)) for surface in surfaces]
    found = complete_surfaces(surfaces, views, 0)
    assert found[0].known.all()
    assert (found[0].support[gap] == 0).all()
    assert np.abs(found[0].points(np.flatnonzero(gap))[:, 2]).max() < 0.01


def test_guide_correction_decays_with_distance() -> None:
    """Catches a guide that is not corrected next to known cells. Also catches a guide that is corrected everywhere
    although only one corner is known."""
    grid = Grid.covering(WIDTH, HEIGHT, 2)
    view = GreyView.from_rgb(CAMERAS[1], np.full((HEIGHT, WIDTH, 3), 90, np.uint8), np.ones((HEIGHT, WIDTH), bool))
    true = floor_map(CAMERAS[1]).inverse_depth.astype(np.float64)
    gap = (np.abs(grid.pixels[:, 0] - 48) < 5) & (np.abs(grid.pixels[:, 1] - 36) < 5)
    corner = (grid.pixels[:, 0] < 20) & (grid.pixels[:, 1] < 20)
    for known, guide, expected in (
        (~gap, true - 0.05, true),
        (corner, true - 0.05, true - 0.05),
        (0 * gap > 0, 0.9 * true, 0.9 * true),
    ):
        surface = surface_of(CAMERAS[1], known)
        surface.depths.planes[~known] = 0
        found = complete_with_guidance([surface], [view], [guide])[0]
        assert found.known.all()
        assert (found.support[~known] == 0).all()
        far = ~known & ~((grid.pixels[:, 0] < 40) & (grid.pixels[:, 1] < 40)) if known is corner else ~known
        np.testing.assert_allclose(found.depths.inverse_depth[far], expected[far], rtol=0.03)


def test_few_known_cells_are_not_extrapolated() -> None:
    """Catches a background that is extrapolated from one known corner."""
    grid = Grid.covering(WIDTH, HEIGHT, 2)
    corner = (grid.pixels[:, 0] < 20) & (grid.pixels[:, 1] < 20)
    surfaces = [surface_of(view, corner) for view in CAMERAS[:2]]
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    views = [GreyView.from_rgb(surface.camera, grey, np.ones((HEIGHT, WIDTH), bool)) for surface in surfaces]
    assert [int(surface.known.sum()) for surface in complete_surfaces(surfaces, views, 0)] == [int(corner.sum())] * 2


def corner_room(view: Camera, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Planes (N, 3) of an image of the floor z = 0 and the wall y = 4. Also returns (N,) bool, whether a cell shows the
    wall."""
    floor, wall = (plane_in_view(plane, view, grid) for plane in (FLOOR, np.array([0.0, 1.0, 0.0, 4.0])))
    inverse = [(planes * grid.pixels).sum(axis=1) for planes in (floor, wall)]
    on_wall = inverse[1] > inverse[0]
    return np.where(on_wall[:, None], wall, floor).astype(np.float32), on_wall


def test_a_wall_ends_where_it_meets_the_floor() -> None:
    """Catches walls that bend towards the cameras because they are interpolated from the last known floor cells."""
    target, up = np.array([0, 3.0, 0.8]), np.array([0, 0, 1.0])
    views = [look_at(np.array([x, -3.0, 1.0]), target, up, INTRINSICS, WIDTH, HEIGHT) for x in (-0.5, 0.5)]
    grid = Grid.covering(WIDTH, HEIGHT, 2)
    surfaces = []
    for view in views:
        planes, on_wall = corner_room(view, grid)
        inverse = (planes * grid.pixels).sum(axis=1)
        # The near part of the floor and a corner of the wall are known. All other cells are completed.
        known = np.where(on_wall, (grid.pixels[:, 0] < 16) & (grid.pixels[:, 1] < 16), inverse > 0.25)
        depths = DepthMap(grid, np.where(known[:, None], planes, 0), known.astype(np.float32))
        surfaces.append(Surface(view, depths, known, known.astype(np.intp)))
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    found = complete_surfaces(
        surfaces, [GreyView.from_rgb(view, grey, np.ones((HEIGHT, WIDTH), bool)) for view in views], 0
    )
    for view, surface in zip(views, found, strict=True):
        planes, _ = corner_room(view, grid)
        truth = (planes * grid.pixels).sum(axis=1)
        assert surface.known.mean() > 0.95
        np.testing.assert_allclose(surface.depths.inverse_depth[surface.known], truth[surface.known], rtol=0.05)


def test_a_table_is_no_enclosing_plane(rng: np.random.Generator) -> None:
    """Catches a tabletop that counts as an enclosing plane, although the floor lies behind it."""
    table = np.column_stack([rng.uniform(-0.5, 0.5, (900, 2)), np.full(900, 0.7)])
    floor = np.column_stack([rng.uniform(-3, 3, (900, 2)), np.zeros(900)])
    found = EnclosingPlanes.from_points(np.vstack([table, floor]), [camera(0.0, -3.0), camera(1.0, -3.0)], rng)
    assert len(found.planes) == 1
    assert abs(found.planes[0, 3]) < 0.01
    assert found.contains(floor).all()
    assert not found.contains(table).any()


@pytest.mark.parametrize("points", [50, 500, 3000])
def test_sample_count_is_close_to_and_below_the_limit(points: int) -> None:
    """Catches a bisection that ends with more samples than allowed."""
    surfaces = [surface_of(view, np.ones(48 * 36, bool)) for view in CAMERAS]
    chosen = sample_surfaces(surfaces, WHOLE * 3, points)
    assert 0.75 * points <= sum(len(samples.xyz) for samples in chosen) <= points


def test_overlap_does_not_raise_the_density() -> None:
    """Catches a floor that gets three times as many samples because three images show it."""
    surfaces = [surface_of(camera(x), np.ones(48 * 36, bool)) for x in (0.0, 0.01, 0.02)]
    counts = [len(samples.xyz) for samples in sample_surfaces(surfaces, WHOLE * 3, 400)]
    assert counts[0] > 0.7 * sum(counts)


def test_samples_have_an_even_spacing() -> None:
    """Catches rows without samples, which are visible as seams on walls. Aliasing between squares and cells causes rows
    without samples."""
    samples = sample_surfaces([surface_of(CAMERAS[1], np.ones(48 * 36, bool))], WHOLE, 700)[0]
    distances, _ = KDTree(samples.xy).query(samples.xy, k=2)
    assert distances[:, 1].max() < 1.6 * distances[:, 1].min()


def test_a_floor_has_no_gaps_from_a_higher_camera() -> None:
    """Catches samples that cover the floor without gaps in the low camera's image, but with gaps in a higher camera's
    image."""
    low, high = (
        look_at(np.array([0, -4.0, z]), np.array([0, 4.0, 0]), np.array([0, 0, 1.0]), INTRINSICS, WIDTH, HEIGHT)
        for z in (0.6, 1.0)
    )
    samples = sample_surfaces([surface_of(low, np.ones(48 * 36, bool))], WHOLE, 600)[0]
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1.5, 1.5, 60), np.linspace(0, 5, 100)))
    floor_pixels, _ = high.project(np.column_stack([x, y, np.zeros_like(x)]))
    pixels, _ = high.project(samples.xyz)
    side = np.sqrt(WIDTH * HEIGHT / 2 / 600)
    assert KDTree(pixels).query(floor_pixels)[0].max() < 1.5 * side


def test_a_floor_has_no_gaps_between_rows() -> None:
    """Catches rows of samples that are adjacent in the low camera's image but far apart on the floor."""
    target, up = np.array([0, 4.0, 0]), np.array([0, 0, 1.0])
    low = look_at(np.array([0, -4.0, 0.6]), target, up, INTRINSICS, WIDTH, HEIGHT)
    xy = sample_surfaces([surface_of(low, np.ones(48 * 36, bool))], WHOLE, 600)[0].xyz[:, :2]
    part = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 60), np.linspace(0, 4, 100)), axis=-1).reshape(-1, 2)
    gap = KDTree(xy).query(part)[0].max()
    within = (np.abs(xy[:, 0]) < 0.8) & (xy[:, 1] > 0) & (xy[:, 1] < 4)
    beside = np.median(KDTree(xy).query(xy[within], k=2)[0][:, 1])
    assert gap < 5 * beside


def test_planes_across_depth_edges_are_not_extrapolated() -> None:
    """Catches points in free space at depth edges, where a cell's plane connects a near and a far surface."""
    surface = surface_of(CAMERAS[1], np.ones(48 * 36, bool))
    middle = surface.depths.inverse_depth.copy()
    edge = np.arange(48 * 36) % 48 == 20
    planes = surface.depths.planes.copy()
    steep = 0.3 * middle[edge]
    planes[edge] = np.column_stack([steep, 0 * steep, middle[edge] - steep * surface.depths.grid.pixels[edge, 0]])
    broken = replace(surface, depths=replace(surface.depths, planes=planes))
    samples = sample_surfaces([broken], WHOLE, 3000)[0]
    assert len(samples.xyz) > 2000
    assert np.abs(samples.xyz[:, 2]).max() < 0.1


def test_confirmed_cells_have_priority() -> None:
    """Catches extrapolated cells of one image that suppress measured cells of another image."""
    surfaces = [surface_of(camera(x), np.ones(48 * 36, bool)) for x in (0.0, 0.02)]
    surfaces[0].support[:] = 0
    extrapolated, measured = sample_surfaces(surfaces, WHOLE * 2, 400)
    assert len(measured.xyz) > 0.8 * (len(extrapolated.xyz) + len(measured.xyz))


def test_no_samples_in_holes() -> None:
    """Catches points with the fill colour of a plate's hole."""
    seen = np.ones((HEIGHT, WIDTH), bool)
    seen[20:50, 30:60] = False
    samples = sample_surfaces([surface_of(CAMERAS[1], np.ones(48 * 36, bool))], [seen], 500)[0]
    columns, rows = np.rint(samples.xy).astype(int).T
    assert seen[rows, columns].all()


def test_large_planes_among_outliers(rng: np.random.Generator) -> None:
    """Catches planes that are fitted to noise, and a plane that is found twice."""
    floor = np.column_stack([rng.uniform(-2, 2, (80, 2)), rng.normal(0, 0.002, 80)])
    wall = np.column_stack([rng.normal(2, 0.002, 60), rng.uniform(0, 2, (60, 2))])
    xyz = np.vstack([floor, wall, rng.uniform(-2, 2, (60, 3))])
    first, second = find_large_planes(xyz, np.ones(len(xyz)), 4.0 * PLANE_TOLERANCE, rng)[:2]
    assert abs(first[2]) > 0.999
    assert abs(first[3]) < 0.01
    assert abs(second[0]) > 0.999
    assert abs(abs(second[3]) - 2) < 0.01


@pytest.mark.parametrize("count", [0, 1, 2, 30])
def test_triangle_planes_of_few_points(count: int, rng: np.random.Generator) -> None:
    """Catches a crash of the triangulation with fewer than three points."""
    grid = Grid.covering(WIDTH, HEIGHT, 4)
    xyz = np.column_stack([rng.uniform(-0.8, 0.8, (count, 2)), np.zeros(count)])
    for planes in triangle_planes(xyz, CAMERAS[1], grid):
        inverse = (planes * grid.pixels).sum(axis=1)
        assert np.isfinite(inverse).any()
        assert np.nanmax(np.abs(inverse - 0.5)) < 1e-3, "the camera looks straight down from 2 m"


def test_sources_overlap_and_have_a_baseline() -> None:
    """Catches the selection of unsuitable source cameras. Unsuitable are the reference camera itself, a camera without
    a baseline, and a camera that sees another part of the scene."""
    away = look_at(np.array([0.3, 0.0, 2.0]), np.array([0.3, 0.0, 9.0]), np.array([0.0, 1, 0]), INTRINSICS, 96, 72)
    cameras = [camera(0.0), camera(0.001), away, camera(0.5), camera(-0.5)]
    chosen = select_sources(cameras, 0, 1.0, 4.0)
    assert set(chosen[:2]) == {3, 4}
    assert 0 not in chosen
    assert 2 not in chosen
    assert select_sources([cameras[0], away], 0, 1.0, 4.0) == []
