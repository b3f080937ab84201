"""The steps from depth maps to points, each on surfaces that are known."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from fourd.background.stereo.completion import filled
from fourd.background.stereo.enclosing_planes import EnclosingPlanes
from fourd.background.stereo.fusion import Surface, agreed
from fourd.background.stereo.guidance import guided
from fourd.background.stereo.patches import GreyView, Grid, Likeness, index_intrinsics
from fourd.background.stereo.patchmatch import DepthMap
from fourd.background.stereo.plane_hypotheses import as_seen, large_planes, triangles
from fourd.background.stereo.source_selection import best_sources
from fourd.background.stereo.thinning import thinned
from fourd.cameras import Camera, look_at

WIDTH, HEIGHT = 96, 72
FLOOR = np.array([0.0, 0.0, 1.0, 0.0])
INTRINSICS = np.array([[90.0, 0, 48], [0, 90, 36], [0, 0, 1]])


def camera(x: float, y: float = 0.0, z: float = 2.0) -> Camera:
    """Looks at the floor's middle."""
    return look_at(np.array([x, y, z]), np.zeros(3), np.array([0.0, 1.0, 0.1]), INTRINSICS, WIDTH, HEIGHT)


CAMERAS = [camera(-0.5), camera(0.0), camera(0.5)]
WHOLE = [np.ones((HEIGHT, WIDTH), bool)]


def floor_map(view: Camera) -> DepthMap:
    """The floor z = 0 as a map that is sure of it."""
    grid = Grid.over(WIDTH, HEIGHT, 2)
    return DepthMap(grid, as_seen(FLOOR, view, grid).copy(), np.full(len(grid.pixels), 0.9, np.float32))


def surface_of(view: Camera, known: np.ndarray) -> Surface:
    return Surface(view, floor_map(view), known, known.astype(np.intp))


def textured(view: Camera, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 3) picture of a floor with blots, the same for the same generator's state."""
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (400, 400)).astype(np.float32), (0, 0), 4)
    texture = cv2.normalize(texture, np.zeros_like(texture), 0, 255, cv2.NORM_MINMAX)
    to_texture = np.array([[100.0, 0, 200], [0, 100, 200], [0, 0, 1]])
    to_pixel = index_intrinsics(view) @ np.column_stack([view.rotation[:, :2], view.translation])
    grey = cv2.warpPerspective(texture, to_pixel @ np.linalg.inv(to_texture), (WIDTH, HEIGHT))
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def test_the_true_plane_is_most_alike() -> None:
    """Catches a half pixel or a sign lost between two pictures: then another plane fits better."""
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    views = [GreyView.of(view, textured(view, np.random.default_rng(5)), everywhere) for view in CAMERAS]
    grid = Grid.over(WIDTH, HEIGHT, 4)
    likeness = Likeness(views[1], (views[0], views[2]), grid)
    cells = np.flatnonzero(likeness.usable)
    true = as_seen(FLOOR, CAMERAS[1], grid)[cells]
    scores = likeness.scores(cells, true)
    assert np.median(scores) > 0.99
    for share in (0.97, 1.03):
        assert (likeness.scores(cells, np.float32(share) * true) < scores).mean() > 0.9


def test_windows_in_holes_count_for_nothing() -> None:
    """Catches correlations with what a hole was filled with."""
    seen = np.ones((HEIGHT, WIDTH), bool)
    seen[4:68, 4:92] = False
    rgb = textured(CAMERAS[1], np.random.default_rng(5))
    holed = GreyView.of(CAMERAS[1], rgb, seen)
    whole = GreyView.of(CAMERAS[0], textured(CAMERAS[0], np.random.default_rng(5)), np.ones_like(seen))
    grid = Grid.over(WIDTH, HEIGHT, 4)
    middle = np.flatnonzero((np.abs(grid.pixels[:, 0] - 50) < 4) & (np.abs(grid.pixels[:, 1] - 35) < 4))
    assert not Likeness(holed, (whole,), grid).usable[middle].any()
    scores = Likeness(whole, (holed,), grid).scores(middle, as_seen(FLOOR, CAMERAS[0], grid)[middle])
    assert (scores == -1).all()


def test_a_plane_that_nobody_sees_scores_nothing() -> None:
    """Catches windows behind a camera, which project into its picture upside down."""
    views = [
        GreyView.of(view, textured(view, np.random.default_rng(5)), np.ones((HEIGHT, WIDTH), bool))
        for view in (
            CAMERAS[1],
            look_at(np.array([0.0, 0, 2.0]), np.array([0.0, 0, 9.0]), np.array([0.0, 1, 0]), INTRINSICS, WIDTH, HEIGHT),
        )
    ]
    grid = Grid.over(WIDTH, HEIGHT, 8)
    cells = np.arange(len(grid.pixels))
    assert (Likeness(views[0], views[1:], grid).scores(cells, as_seen(FLOOR, CAMERAS[1], grid)) == -1).all()


def test_what_the_others_contradict_is_dropped() -> None:
    """Catches a single map's mistake that becomes points hanging in the air."""
    maps = [floor_map(view) for view in CAMERAS]
    wrong = (np.abs(maps[1].grid.pixels[:, 0] - 48) < 12) & (np.abs(maps[1].grid.pixels[:, 1] - 36) < 12)
    planes = maps[1].planes.copy()
    planes[wrong] *= 1.5
    found = agreed(CAMERAS, [maps[0], replace(maps[1], planes=planes), maps[2]])
    assert not found[1].known[wrong].any()
    assert found[1].known[~wrong].mean() > 0.8
    assert found[0].known.mean() > 0.7
    assert np.abs(found[1].points(np.flatnonzero(found[1].known))[:, 2]).max() < 1e-3


def test_one_other_picture_is_enough_and_none_is_not() -> None:
    """Catches walls lost that two cameras alone see, and cells kept that nothing confirms."""
    left, right = camera(-0.9), camera(0.9)
    found = agreed([left, right], [floor_map(left), floor_map(right)])
    pixels, depth = right.project(found[0].points(np.arange(len(found[0].known))))
    own = found[0].depths.grid.pixels[:, :2]
    shared = (depth > 0) & np.logical_and.reduce(
        [(at > 4).all(axis=1) & (at < (WIDTH - 4, HEIGHT - 4)).all(axis=1) for at in (pixels, own)]
    )
    outside = (pixels < -2).any(axis=1) | (pixels > (WIDTH + 2, HEIGHT + 2)).any(axis=1)
    assert found[0].known[shared].all()
    assert not found[0].known[outside].any()
    assert (found[0].support[shared] == 1).all()


def test_crumbs_are_dropped() -> None:
    """Catches cells that agree by chance: alone, they are the outliers that a membrane would hang on."""
    maps = [floor_map(view) for view in CAMERAS]
    numbers = np.arange(len(maps[0].scores)).reshape(maps[0].grid.shape)
    kept = np.zeros(len(maps[0].scores), bool)
    kept[numbers[4:8, 4:8]] = True
    kept[numbers[20:30, 20:30]] = True
    maps[1] = replace(maps[1], scores=np.where(kept, 0.9, 0).astype(np.float32))
    found = agreed(CAMERAS, maps)[1].known
    assert not found[numbers[4:8, 4:8]].any()
    assert found[numbers[20:30, 20:30]].all()


def test_a_gap_in_a_floor_is_floor() -> None:
    """Catches interpolation of depths instead of inverse depths, which bends planes."""
    grid = Grid.over(WIDTH, HEIGHT, 2)
    gap = (np.abs(grid.pixels[:, 0] - 48) < 20) & (np.abs(grid.pixels[:, 1] - 36) < 16)
    surfaces = [surface_of(view, ~gap) for view in (camera(-0.5), camera(-0.45))]
    for surface in surfaces:
        surface.depths.planes[gap] = 0
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    views = [GreyView.of(surface.camera, grey, np.ones((HEIGHT, WIDTH), bool)) for surface in surfaces]
    found = filled(surfaces, views, 0)
    assert found[0].known.all()
    assert (found[0].support[gap] == 0).all()
    assert np.abs(found[0].points(np.flatnonzero(gap))[:, 2]).max() < 0.01


def test_a_guide_decides_far_from_what_is_known() -> None:
    """Catches a guide that is not moved to what is known beside it, and a known corner that moves it everywhere."""
    grid = Grid.over(WIDTH, HEIGHT, 2)
    view = GreyView.of(CAMERAS[1], np.full((HEIGHT, WIDTH, 3), 90, np.uint8), np.ones((HEIGHT, WIDTH), bool))
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
        found = guided([surface], [view], [guide])[0]
        assert found.known.all()
        assert (found.support[~known] == 0).all()
        far = ~known & ~((grid.pixels[:, 0] < 40) & (grid.pixels[:, 1] < 40)) if known is corner else ~known
        np.testing.assert_allclose(found.depths.inverse_depth[far], expected[far], rtol=0.03)


def test_little_known_is_not_stretched_over_a_picture() -> None:
    """Catches a membrane hung on a corner that passes for a background."""
    grid = Grid.over(WIDTH, HEIGHT, 2)
    corner = (grid.pixels[:, 0] < 20) & (grid.pixels[:, 1] < 20)
    surfaces = [surface_of(view, corner) for view in CAMERAS[:2]]
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    views = [GreyView.of(surface.camera, grey, np.ones((HEIGHT, WIDTH), bool)) for surface in surfaces]
    assert [int(surface.known.sum()) for surface in filled(surfaces, views, 0)] == [int(corner.sum())] * 2


def corner_room(view: Camera, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Planes (N, 3) of the floor z = 0 and the wall y = 4 as a picture has them, and which cells are wall."""
    floor, wall = (as_seen(plane, view, grid) for plane in (FLOOR, np.array([0.0, 1.0, 0.0, 4.0])))
    inverse = [(planes * grid.pixels).sum(axis=1) for planes in (floor, wall)]
    on_wall = inverse[1] > inverse[0]
    return np.where(on_wall[:, None], wall, floor).astype(np.float32), on_wall


def test_a_wall_stands_where_the_floor_meets_it() -> None:
    """Catches walls hung on the last bit of floor that is known, which bend towards the cameras."""
    target, up = np.array([0, 3.0, 0.8]), np.array([0, 0, 1.0])
    views = [look_at(np.array([x, -3.0, 1.0]), target, up, INTRINSICS, WIDTH, HEIGHT) for x in (-0.5, 0.5)]
    grid = Grid.over(WIDTH, HEIGHT, 2)
    surfaces = []
    for view in views:
        planes, on_wall = corner_room(view, grid)
        inverse = (planes * grid.pixels).sum(axis=1)
        # Of the floor what is near, and of the wall a corner: between them, and beside, all is to be guessed.
        known = np.where(on_wall, (grid.pixels[:, 0] < 16) & (grid.pixels[:, 1] < 16), inverse > 0.25)
        depths = DepthMap(grid, np.where(known[:, None], planes, 0), known.astype(np.float32))
        surfaces.append(Surface(view, depths, known, known.astype(np.intp)))
    grey = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    found = filled(surfaces, [GreyView.of(view, grey, np.ones((HEIGHT, WIDTH), bool)) for view in views], 0)
    for view, surface in zip(views, found, strict=True):
        planes, _ = corner_room(view, grid)
        truth = (planes * grid.pixels).sum(axis=1)
        assert surface.known.mean() > 0.95
        np.testing.assert_allclose(surface.depths.inverse_depth[surface.known], truth[surface.known], rtol=0.05)


def test_a_table_encloses_nothing(rng: np.random.Generator) -> None:
    """Catches a table's top continued through the room: there is floor behind it."""
    table = np.column_stack([rng.uniform(-0.5, 0.5, (900, 2)), np.full(900, 0.7)])
    floor = np.column_stack([rng.uniform(-3, 3, (900, 2)), np.zeros(900)])
    found = EnclosingPlanes.of(np.vstack([table, floor]), [camera(0.0, -3.0), camera(1.0, -3.0)], rng)
    assert len(found.planes) == 1
    assert abs(found.planes[0, 3]) < 0.01
    assert found.on(floor).all()
    assert not found.on(table).any()


@pytest.mark.parametrize("points", [50, 500, 3000])
def test_never_more_points_than_wanted_and_nearly_as_many(points: int) -> None:
    """Catches a search that stops on its wrong side."""
    surfaces = [surface_of(view, np.ones(48 * 36, bool)) for view in CAMERAS]
    chosen = thinned(surfaces, WHOLE * 3, points)
    assert 0.75 * points <= sum(len(places.xyz) for places in chosen) <= points


def test_what_all_see_gets_no_more_points() -> None:
    """Catches a cloud three times as dense where three pictures show one floor."""
    surfaces = [surface_of(camera(x), np.ones(48 * 36, bool)) for x in (0.0, 0.01, 0.02)]
    counts = [len(places.xyz) for places in thinned(surfaces, WHOLE * 3, 400)]
    assert counts[0] > 0.7 * sum(counts)


def test_points_lie_evenly() -> None:
    """Catches rows left out where squares and cells beat: they show as seams on a wall."""
    places = thinned([surface_of(CAMERAS[1], np.ones(48 * 36, bool))], WHOLE, 700)[0]
    distances, _ = KDTree(places.xy).query(places.xy, k=2)
    assert distances[:, 1].max() < 1.6 * distances[:, 1].min()


def test_another_camera_finds_no_gaps_in_a_floor() -> None:
    """Catches a floor that is covered for the low camera that saw it alone: one that stands higher looks between."""
    low, high = (
        look_at(np.array([0, -4.0, z]), np.array([0, 4.0, 0]), np.array([0, 0, 1.0]), INTRINSICS, WIDTH, HEIGHT)
        for z in (0.6, 1.0)
    )
    places = thinned([surface_of(low, np.ones(48 * 36, bool))], WHOLE, 600)[0]
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1.5, 1.5, 60), np.linspace(0, 5, 100)))
    asked, _ = high.project(np.column_stack([x, y, np.zeros_like(x)]))
    pixels, _ = high.project(places.xyz)
    side = np.sqrt(WIDTH * HEIGHT / 2 / 600)
    assert KDTree(pixels).query(asked)[0].max() < 1.5 * side


def test_another_camera_finds_no_long_gaps_in_a_floor() -> None:
    """Catches rows on a floor that are far apart, as the low camera that saw it shows them side by side."""
    target, up = np.array([0, 4.0, 0]), np.array([0, 0, 1.0])
    low = look_at(np.array([0, -4.0, 0.6]), target, up, INTRINSICS, WIDTH, HEIGHT)
    xy = thinned([surface_of(low, np.ones(48 * 36, bool))], WHOLE, 600)[0].xyz[:, :2]
    part = np.stack(np.meshgrid(np.linspace(-0.8, 0.8, 60), np.linspace(0, 4, 100)), axis=-1).reshape(-1, 2)
    gap = KDTree(xy).query(part)[0].max()
    within = (np.abs(xy[:, 0]) < 0.8) & (xy[:, 1] > 0) & (xy[:, 1] < 4)
    beside = np.median(KDTree(xy).query(xy[within], k=2)[0][:, 1])
    assert gap < 5 * beside


def test_planes_across_an_edge_are_not_followed() -> None:
    """Catches points strung along rays, where a cell's plane leads from something near to something far behind it."""
    surface = surface_of(CAMERAS[1], np.ones(48 * 36, bool))
    middle = surface.depths.inverse_depth.copy()
    edge = np.arange(48 * 36) % 48 == 20
    planes = surface.depths.planes.copy()
    steep = 0.3 * middle[edge]
    planes[edge] = np.column_stack([steep, 0 * steep, middle[edge] - steep * surface.depths.grid.pixels[edge, 0]])
    broken = replace(surface, depths=replace(surface.depths, planes=planes))
    places = thinned([broken], WHOLE, 3000)[0]
    assert len(places.xyz) > 2000
    assert np.abs(places.xyz[:, 2]).max() < 0.1


def test_what_is_confirmed_comes_first() -> None:
    """Catches guesses of one picture that keep out what another has measured."""
    surfaces = [surface_of(camera(x), np.ones(48 * 36, bool)) for x in (0.0, 0.02)]
    surfaces[0].support[:] = 0
    guessed, measured = thinned(surfaces, WHOLE * 2, 400)
    assert len(measured.xyz) > 0.8 * (len(guessed.xyz) + len(measured.xyz))


def test_no_points_in_holes() -> None:
    """Catches points with the colours that a plate's hole was filled with."""
    seen = np.ones((HEIGHT, WIDTH), bool)
    seen[20:50, 30:60] = False
    places = thinned([surface_of(CAMERAS[1], np.ones(48 * 36, bool))], [seen], 500)[0]
    columns, rows = np.rint(places.xy).astype(int).T
    assert seen[rows, columns].all()


def test_large_planes_among_chance_points(rng: np.random.Generator) -> None:
    """Catches planes through noise, and a second plane that is the first again."""
    floor = np.column_stack([rng.uniform(-2, 2, (80, 2)), rng.normal(0, 0.002, 80)])
    wall = np.column_stack([rng.normal(2, 0.002, 60), rng.uniform(0, 2, (60, 2))])
    xyz = np.vstack([floor, wall, rng.uniform(-2, 2, (60, 3))])
    first, second = large_planes(xyz, np.ones(len(xyz)), 4.0, rng)[:2]
    assert abs(first[2]) > 0.999
    assert abs(first[3]) < 0.01
    assert abs(second[0]) > 0.999
    assert abs(abs(second[3]) - 2) < 0.01


@pytest.mark.parametrize("count", [0, 1, 2, 30])
def test_triangles_of_few_points(count: int, rng: np.random.Generator) -> None:
    """Catches a crash of the triangulation for less than three points."""
    grid = Grid.over(WIDTH, HEIGHT, 4)
    xyz = np.column_stack([rng.uniform(-0.8, 0.8, (count, 2)), np.zeros(count)])
    for planes in triangles(xyz, CAMERAS[1], grid):
        inverse = (planes * grid.pixels).sum(axis=1)
        assert np.isfinite(inverse).any()
        assert np.nanmax(np.abs(inverse - 0.5)) < 1e-3, "the camera looks straight down from 2 m"


def test_sources_see_the_same_and_stand_apart() -> None:
    """Catches a picture compared with itself, with one from its own place, or with one that looks away."""
    away = look_at(np.array([0.3, 0.0, 2.0]), np.array([0.3, 0.0, 9.0]), np.array([0.0, 1, 0]), INTRINSICS, 96, 72)
    cameras = [camera(0.0), camera(0.001), away, camera(0.5), camera(-0.5)]
    chosen = best_sources(cameras, 0, 1.0, 4.0)
    assert set(chosen[:2]) == {3, 4}
    assert 0 not in chosen
    assert 2 not in chosen
    assert best_sources([cameras[0], away], 0, 1.0, 4.0) == []
