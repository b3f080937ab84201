"""A radiance field of a room that is known, and the parts that it is made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from fourd.background.contraction import Contraction, contraction_around
from fourd.background.plates import PlateView
from fourd.background.radiance import from_radiance as points_module
from fourd.background.radiance.config import RadianceConfig
from fourd.background.radiance.depths import field_depths, median_inverse_depths
from fourd.background.radiance.field import RadianceField, bounded_exp
from fourd.background.radiance.fitting import FittedField, fit_field
from fourd.background.radiance.from_radiance import seed_from_radiance
from fourd.background.radiance.occupancy import OccupancyGrid
from fourd.background.radiance.pixels import Pixels
from fourd.background.radiance.rays import Rays, camera_rays, resampled, to_distance, to_share
from fourd.background.radiance.room_depth import Room as Around
from fourd.background.radiance.volume_rendering import distortion, light_weights, spent_share
from fourd.background.shell import viewing_centre
from fourd.background.stereo.depth_maps import Measured, Small
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.patchmatch import DepthMap
from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.progress import untracked
from tests.calibration.rooms import Room, room_cameras, room_depth

SMALL = RadianceConfig(
    levels=6, log2_entries=14, finest=256, hidden=16, occupancy=48, steps=250, rays=320, samples=16, rate=2e-2
)
WIDTH, HEIGHT = 80, 60


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def true_surface(small: Small, known: np.ndarray | None = None) -> Surface:
    """What a plate shows of the room, some of its cells counted as measured."""
    grid = small.grid()
    depth = room_depth(small.camera)[grid.indices]
    sure = np.ones(len(depth), bool) if known is None else known
    scores = np.where(sure, 0.9, 0).astype(np.float32)
    return Surface(small.camera, DepthMap.through(grid, 1 / depth, scores), sure, sure.astype(np.intp))


def patches(small: Small, rng: np.random.Generator) -> np.ndarray:
    """(N,) a third of a plate's cells, in squares of 5 x 5."""
    rows, columns = small.grid().shape
    squares = rng.random((rows // 5 + 1, columns // 5 + 1)) < 0.33
    return np.kron(squares, np.ones((5, 5), bool))[:rows, :columns].ravel()


@pytest.fixture(scope="module")
def smalls() -> list[Small]:
    room = Room(np.random.default_rng(3))
    cameras = room_cameras(4, WIDTH, HEIGHT)
    return [Small(camera, room.picture(camera), np.ones((HEIGHT, WIDTH), bool)) for camera in cameras]


def pixels_of(smalls: list[Small], surfaces: list[Surface], contraction: Contraction) -> Pixels:
    return Pixels.of(smalls, surfaces, surfaces, contraction.radius)


def space_of(smalls: list[Small]) -> Contraction:
    cameras = [small.camera for small in smalls]
    return contraction_around(cameras, viewing_centre(cameras))


def test_a_field_finds_depths_between_those_that_are_measured(smalls: list[Small]) -> None:
    """Catches rays that are not the pixels', depths mistaken for distances, and a prior that colours overrule."""
    rng = np.random.default_rng(0)
    surfaces = [true_surface(small, patches(small, rng)) for small in smalls]
    space = space_of(smalls)
    pixels = pixels_of(smalls, surfaces, space)
    field = fit_field(pixels, space, SMALL, seed=0)
    measured, others = [], []
    for small, surface in zip(smalls, surfaces, strict=True):
        grid = small.grid()
        found = median_inverse_depths(field, small, grid.pixels[:, :2].astype(np.float64))
        away = np.abs(found * room_depth(small.camera)[grid.indices] - 1)
        measured.append(away[surface.known])
        others.append(away[~surface.known])
    assert np.median(np.concatenate(measured)) < 0.04
    assert np.median(np.concatenate(others)) < 0.045
    batch = pixels.draw(2000, generator(3))
    picture = field.look(batch.rays, 48).rgb
    assert (picture - batch.rgb).square().mean() < 0.93 * batch.rgb.var(0).mean(), "one colour would have 1"


def test_the_same_seed_gives_the_same_field(smalls: list[Small]) -> None:
    """Catches chance that does not come from the seed, and chance of the process that a fit uses up."""
    space = space_of(smalls)
    pixels = pixels_of(smalls, [true_surface(small) for small in smalls], space)
    config = replace(SMALL, steps=4)
    before = torch.get_rng_state()
    first, again, other = (fit_field(pixels, space, config, seed).radiance.table for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert torch.equal(torch.get_rng_state(), before)


class _Fog(RadianceField):
    """So dense that nothing is seen."""

    def density(self, xyz: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.full((len(xyz),), 1e4), torch.zeros(len(xyz), 15)


def test_what_no_other_plate_confirms_is_not_known(smalls: list[Small]) -> None:
    """Catches a field's noise that passes for a measurement, and measured cells overwritten by it."""
    space = space_of(smalls)
    field = FittedField(_Fog(SMALL.grid, space, SMALL.hidden), OccupancyGrid(space, SMALL.occupancy))
    half = [np.arange(len(small.grid().pixels)) % 2 == 0 for small in smalls]
    measured = [true_surface(small, known) for small, known in zip(smalls, half, strict=True)]
    guesses = [true_surface(small) for small in smalls]
    found = field_depths(field, smalls, measured, guesses, untracked)
    for mine, truth, guess in zip(found, measured, guesses, strict=True):
        assert (mine.depths.planes[truth.known] == truth.depths.planes[truth.known]).all()
        assert (mine.depths.planes[~truth.known] == guess.depths.planes[~truth.known]).all()
        assert mine.known.all()
        assert ((mine.support > 0) == truth.known).all(), "each plate's light ends before its own lens"
    alone = field_depths(field, smalls, measured, measured, untracked)
    assert all((mine.known == truth.known).all() for mine, truth in zip(alone, measured, strict=True))


def test_shares_and_distances_are_each_others_inverse() -> None:
    """Catches a seam at the middle of rays, and distances that do not grow."""
    share = torch.linspace(0, 1, 301)
    distance = to_distance(share)
    assert (distance.diff() > 0).all()
    torch.testing.assert_close(to_share(distance), share, atol=1e-5, rtol=0)
    assert to_share(torch.tensor([0.0, 1e9])).tolist() == pytest.approx([0, 1], abs=1e-2)


def test_rays_meet_what_their_pixels_show(rng: np.random.Generator) -> None:
    """Catches half pixels, and camera frames mistaken for the world's."""
    camera = room_cameras(3)[1]
    places = torch.from_numpy(rng.uniform((0, 0), (camera.width, camera.height), (20, 2)))
    rays = camera_rays(camera, places)
    xyz = rays.at(torch.full((20, 1), 1.5), 2.0)[:, 0].numpy()
    pixels, depth = camera.project(xyz.astype(np.float64))
    np.testing.assert_allclose(pixels, places.numpy(), atol=1e-2)
    assert (depth > 0).all()
    np.testing.assert_allclose(np.linalg.norm(xyz - camera.centre, axis=1), 3.0, atol=1e-4)


def test_drawn_rays_are_the_pixels(smalls: list[Small]) -> None:
    """Catches one plate's pixels with another's camera, and depths where there are holes."""
    holed = [replace(small, seen=np.arange(WIDTH) > 30 + 0 * small.seen) for small in smalls]
    space = space_of(smalls)
    surfaces = [true_surface(small) for small in smalls]
    batch = pixels_of(holed, surfaces, space).draw(200, generator())
    xyz = batch.rays.at(to_distance(batch.share)[:, None], space.radius)[:, 0].numpy()
    for row in range(200):
        which = int(np.argmin([np.linalg.norm(s.camera.centre - batch.rays.origins[row].numpy()) for s in smalls]))
        pixel, depth = smalls[which].camera.project(xyz[row : row + 1].astype(np.float64))
        column, line = pixel[0].astype(int)
        assert column > 30
        assert smalls[which].rgb[line, column] / 255 == pytest.approx(batch.rgb[row].numpy(), abs=1e-5)
        assert depth[0] == pytest.approx(room_depth(smalls[which].camera)[line, column], rel=0.1)


def test_light_is_spent_or_passes(rng: np.random.Generator) -> None:
    """Catches transmittance that counts an interval's own density twice or not at all."""
    density, lengths = (torch.from_numpy(rng.uniform(0, 3, (5, 7))) for _ in range(2))
    weights, passing = light_weights(density, lengths)
    torch.testing.assert_close(weights.sum(1) + passing, torch.ones(5, dtype=torch.float64))
    torch.testing.assert_close(weights[:, 0], 1 - torch.exp(-density[:, 0] * lengths[:, 0]))
    torch.testing.assert_close(passing, torch.exp(-(density * lengths).sum(1)))


def test_distortion_is_that_of_the_paper(rng: np.random.Generator) -> None:
    """Catches a wrong prefix sum: against the double sum of the paper's eq. 15."""
    edges = torch.from_numpy(np.sort(rng.random((4, 9)), axis=1))
    weights = torch.from_numpy(rng.random((4, 8)))
    middles, lengths = (edges[:, 1:] + edges[:, :-1]) / 2, edges.diff(dim=1)
    apart = (middles[:, :, None] - middles[:, None]).abs()
    expected = (weights[:, :, None] * weights[:, None] * apart).sum((1, 2)) + (weights**2 * lengths).sum(1) / 3
    torch.testing.assert_close(distortion(weights, edges), expected)


def test_the_median_lies_where_half_the_light_is_spent() -> None:
    """Catches an interval's start or end in place of the part of it."""
    edges = torch.linspace(0, 1, 5)[None].repeat(3, 1)
    weights = torch.tensor([[0.0, 1.0, 0.0, 0.0], [0.25, 0.5, 0.25, 0.0], [0.1, 0.1, 0.1, 0.1]])
    assert spent_share(weights, edges, 0.5).tolist() == pytest.approx([0.375, 0.375, 1.0])
    assert spent_share(weights, edges, 0.25).tolist() == pytest.approx([0.3125, 0.25, 0.625])


def test_edges_fall_where_the_histogram_is(rng: np.random.Generator) -> None:
    """Catches edges out of order or outside, and empty bins that get as many as full ones."""
    edges = torch.linspace(0, 1, 11)
    weights = torch.zeros(2, 10)
    weights[0, 3] = 1
    weights[1] = 1
    for jitter in (None, torch.from_numpy(rng.random((2, 21)).astype(np.float32))):
        found = resampled(edges, weights, 20, jitter)
        assert (found.diff(dim=1) >= 0).all()
        assert ((found[0] >= 0.3 - 1e-6) & (found[0] <= 0.4 + 1e-6)).all()
        assert found[1, 0] < 0.06
        assert found[1, -1] > 0.94


def one_ray() -> Rays:
    """From (-1, 0, 0) along x."""
    return Rays(torch.tensor([[-1.0, 0, 0]]), torch.tensor([[1.0, 0, 0]]))


def test_samples_fall_where_something_was_found() -> None:
    """Catches samples spent on empty space, and none there to find what is new."""
    grid = OccupancyGrid(Contraction((0.0, 0.0, 0.0), 1.0), 64)
    place = torch.tensor([[0.3, 0.0, 0.0]])
    even = to_distance(grid.sample(one_ray(), 32, None)[0])
    grid.update(place, torch.tensor([200.0]))
    found = to_distance(grid.sample(one_ray(), 32, None)[0])
    assert ((even - 1.3).abs() < 0.15).sum() < 5
    assert ((found - 1.3).abs() < 0.15).sum() > 16
    assert (found < 1.0).any()
    assert (found > 2.0).any()
    hinted = to_distance(grid.sample(one_ray(), 32, None, to_share(torch.tensor([0.6])))[0])
    assert ((hinted - 0.6).abs() < 0.15).sum() > 8
    untracked = grid.sample(one_ray(), 32, None, torch.tensor([torch.nan]))
    assert torch.equal(untracked, grid.sample(one_ray(), 32, None))


def test_densities_fade_unless_they_are_found_again() -> None:
    """Catches cells that stay full for ever, and the last of a batch's densities in place of the largest."""
    grid = OccupancyGrid(Contraction((0.0, 0.0, 0.0), 1.0), 8)
    place = torch.tensor([[0.1, 0.1, 0.1], [0.1, 0.1, 0.1], [0.1, 0.1, 0.1]])
    grid.update(place, torch.tensor([1.0, 5.0, 2.0]))
    cell = grid.cell_of(place)[0]
    assert grid.density[cell] == 5
    grid.update(place, torch.zeros(3))
    assert 4 < grid.density[cell] < 5
    assert (grid.density > 0).sum() == 1


def test_a_full_place_can_empty_again() -> None:
    """Catches a clamp whose gradient vanishes, which keeps what once was opaque."""
    log_density = torch.tensor([20.0, 0.5], requires_grad=True)
    bounded_exp(log_density).sum().backward()
    assert log_density.grad is not None
    assert log_density.grad.tolist() == pytest.approx([float(np.exp(11.0)), float(np.exp(0.5))], rel=1e-4)


def test_what_one_plate_shows_is_continued_along_the_horizon(smalls: list[Small]) -> None:
    """Catches walls that lean towards the floor below them where nothing is measured."""
    surfaces = []
    for index, small in enumerate(smalls):
        known = small.grid().pixels[:, 0] < (WIDTH if index % 2 else WIDTH // 2)
        surfaces.append(true_surface(small, known))
    around = Around.around(surfaces, np.array([0.3, 0.3, 0.9]))
    assert around is not None
    for small, surface in zip(smalls[::2], surfaces[::2], strict=True):
        ratio = around.seen_by(surface) * room_depth(small.camera)[small.grid().indices]
        assert np.median(np.abs(ratio - 1)) < 0.03
        assert np.percentile(np.abs(ratio - 1), 90) < 0.2
    few = [replace(surface, known=np.arange(len(surface.known)) % 100 == 0) for surface in surfaces]
    hall = Around.around(few, np.array([0.3, 0.3, 0.9]))
    assert hall is not None
    for small, surface in zip(smalls, few, strict=True):
        assert (hall.seen_by(surface) * np.linalg.norm(small.camera.centre - (0.3, 0.3, 0.9)) < 3).all(), (
            "not at a lens"
        )
    nothing = [replace(surface, known=np.zeros_like(surface.known)) for surface in surfaces]
    assert Around.around(nothing, np.zeros(3)) is None


def plates_of(smalls: list[Small]) -> list[PlateView]:
    return [PlateView(f"{index:02d}", small.camera, small.rgb, small.seen) for index, small in enumerate(smalls)]


def test_blank_walls_are_refused(smalls: list[Small]) -> None:
    """Catches minutes spent on a field that nothing can tell any depth, and a scene without a background."""
    blank = [replace(plate, rgb=np.full_like(plate.rgb, 200)) for plate in plates_of(smalls)]
    with pytest.raises(
        UserError, match=r"plates: expected at least 8 features .*, got 0; .*--background FILE.ply"
    ) as told:
        seed_from_radiance(blank, 1000, SMALL)
    assert "\n" not in str(told.value)


def test_what_neither_stereo_nor_the_field_finds_is_told(smalls: list[Small], monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches fog, which all plates place alike, in place of a background, and a field left alone without a word."""
    few = [true_surface(small, np.arange(len(small.grid().pixels)) % 400 == 0) for small in smalls]
    monkeypatch.setattr(points_module, "measured", lambda *given: Measured(20, 20, smalls, few))
    lines: list[str] = []
    config = replace(SMALL, steps=2)
    with pytest.raises(UserError, match=r"at least 1% .* that two of them agree on, got 0\.\d%; .*--background FILE"):
        seed_from_radiance(plates_of(smalls), 500, config, log=lines.append)
    assert "too little to tell the field" in lines[1]


@pytest.mark.parametrize(("count", "points"), [(1, 10), (3, 0)])
def test_impossible_wishes(smalls: list[Small], count: int, points: int) -> None:
    """Catches a failure deep inside for a call that cannot be meant."""
    with pytest.raises(ValueError, match="expected at least 2 plates and 1 point"):
        seed_from_radiance(plates_of(smalls)[:count], points, SMALL)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"levels": 0}, "levels: expected 1 to 32, got 0"),
        ({"steps": 0}, "steps: expected at least 1, got 0"),
        ({"measured": -1.0}, "measured: expected 0 or more, got -1.0"),
        ({"rate": float("nan")}, "rate: expected 0 or more, got nan"),
    ],
)
def test_impossible_fields_are_refused(change: dict[str, float], message: str) -> None:
    """Catches a config that fails minutes later, deep inside."""
    with pytest.raises(ValueError, match=message):
        replace(RadianceConfig(), **change)  # type: ignore[arg-type]


def to_walls(xyz: np.ndarray) -> np.ndarray:
    """(N,) distance to the nearest face of the room."""
    x, y, z = np.abs(xyz.astype(np.float64).T)
    return np.min([np.abs(x - 2.0), np.abs(y - 2.0), z, np.abs(z - 2.4)], axis=0)


@pytest.mark.slow
def test_points_of_a_room(rng: np.random.Generator) -> None:
    """Catches a way from plates to points that does not hang together, and guesses that are not told."""
    room = Room(np.random.default_rng(3))
    cameras: list[Camera] = room_cameras(3, 144, 108)
    plates = [
        PlateView(f"{i}", camera, room.picture(camera), np.ones((108, 144), bool)) for i, camera in enumerate(cameras)
    ]
    lines: list[str] = []
    found = seed_from_radiance(plates, 1500, replace(SMALL, steps=150), log=lines.append)
    assert 1200 <= len(found.xyz) <= 1500
    apart = to_walls(found.xyz)
    assert np.median(apart) < 0.01
    assert np.percentile(apart, 90) < 0.15
    assert lines[0].startswith("stereo: ")
    assert f"points: {len(found.xyz)}, " in lines[1]
    assert "guesses of what one plate alone shows" in lines[1]
