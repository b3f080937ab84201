"""The radiance field: its components, and the field of a known room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.reconstruction.background.contraction import Contraction, contraction_around
from fourd.reconstruction.background.plates import PlateView
from fourd.reconstruction.background.radiance.config import RadianceConfig
from fourd.reconstruction.background.radiance.depths import add_field_depths, median_inverse_depths
from fourd.reconstruction.background.radiance.field import RadianceField, bounded_exp
from fourd.reconstruction.background.radiance.from_radiance import seed_from_radiance
from fourd.reconstruction.background.radiance.occupancy import OccupancyGrid
from fourd.reconstruction.background.radiance.optimization import OptimizedField, optimize_field
from fourd.reconstruction.background.radiance.pixels import Pixels
from fourd.reconstruction.background.radiance.rays import MAX_NEAR, NEAR, RayRange, Rays, camera_rays, resample_edges
from fourd.reconstruction.background.radiance.room_depth import Room as RoomShape
from fourd.reconstruction.background.radiance.volume_rendering import (
    distortion_loss,
    rendering_weights,
    weight_quantile,
)
from fourd.recording.capture.focus import viewing_centre
from fourd.recording.stereo.depth_maps import ReducedPlate, StereoResult, reconstruct_surfaces
from fourd.recording.stereo.fusion import Surface
from fourd.recording.stereo.patchmatch import DepthMap
from tests.calibration.rooms import Room, room_cameras, room_depth

SMALL = RadianceConfig(
    levels=6, log2_entries=14, finest=256, hidden=16, occupancy=48, steps=250, rays=320, samples=16, rate=2e-2
)
WIDTH, HEIGHT = 80, 60


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def true_surface(plate: ReducedPlate, known: np.ndarray | None = None) -> Surface:
    """The true surface of a plate. ``known`` (N,) selects the cells that are marked as measured. By default, all cells
    are marked."""
    grid = plate.grid()
    depth = room_depth(plate.camera)[grid.indices]
    measured = np.ones(len(depth), bool) if known is None else known
    scores = np.where(measured, 0.9, 0).astype(np.float32)
    depths = DepthMap.from_inverse_depth(grid, 1 / depth, scores)
    return Surface(plate.camera, depths, measured, measured.astype(np.intp))


def random_blocks(plate: ReducedPlate, rng: np.random.Generator) -> np.ndarray:
    """(N,) bool: a selection of a third of a plate's cells, in blocks of 5 x 5."""
    rows, columns = plate.grid().shape
    squares = rng.random((rows // 5 + 1, columns // 5 + 1)) < 0.33
    return np.kron(squares, np.ones((5, 5), bool))[:rows, :columns].ravel()


@pytest.fixture(autouse=True)
def _coarse_directions(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rooms of these tests have no detail. The factorization for a fine grid takes most of their time."""
    monkeypatch.setattr("fourd.reconstruction.background.radiance.room_depth.ROWS_PER_DEGREE", 1)


@pytest.fixture(scope="module")
def reduced() -> list[ReducedPlate]:
    room = Room(np.random.default_rng(3))
    cameras = room_cameras(4, WIDTH, HEIGHT)
    return [ReducedPlate(camera, room.picture(camera), np.ones((HEIGHT, WIDTH), bool)) for camera in cameras]


def pixels_of(reduced: list[ReducedPlate], surfaces: list[Surface], contraction: Contraction) -> Pixels:
    return Pixels.from_plates(reduced, surfaces, surfaces, contraction.radius, RayRange())


def space_of(reduced: list[ReducedPlate]) -> Contraction:
    cameras = [plate.camera for plate in reduced]
    return contraction_around(cameras, viewing_centre(cameras))


def test_field_depths_between_measured_cells(reduced: list[ReducedPlate]) -> None:
    """Catches wrong rays, depths mistaken for distances, and colours that override measured depths."""
    rng = np.random.default_rng(0)
    surfaces = [true_surface(plate, random_blocks(plate, rng)) for plate in reduced]
    space = space_of(reduced)
    pixels = pixels_of(reduced, surfaces, space)
    field = optimize_field(pixels, space, SMALL, seed=0)
    measured, others = [], []
    for plate, surface in zip(reduced, surfaces, strict=True):
        grid = plate.grid()
        found = median_inverse_depths(field, plate, grid.pixels[:, :2].astype(np.float64))
        error = np.abs(found * room_depth(plate.camera)[grid.indices] - 1)
        measured.append(error[surface.known])
        others.append(error[~surface.known])
    assert np.median(np.concatenate(measured)) < 0.04
    assert np.median(np.concatenate(others)) < 0.045
    batch = pixels.sample(2000, generator(3))
    picture = field.render(batch.rays, 48).rgb
    assert (picture - batch.rgb).square().mean() < 0.93 * batch.rgb.var(0).mean(), "a constant colour has ratio 1"


def test_the_same_seed_gives_the_same_field(reduced: list[ReducedPlate]) -> None:
    """Catches results that differ with the same seed, and changes to torch's global random generator."""
    space = space_of(reduced)
    pixels = pixels_of(reduced, [true_surface(plate) for plate in reduced], space)
    config = replace(SMALL, steps=4)
    before = torch.get_rng_state()
    first, again, other = (optimize_field(pixels, space, config, seed).radiance.table for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert torch.equal(torch.get_rng_state(), before)


class _Fog(RadianceField):
    """Create a field that is opaque everywhere."""

    def density(self, xyz: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.full((len(xyz),), 1e4), torch.zeros(len(xyz), 15)


def test_unconfirmed_field_depths_are_not_used(reduced: list[ReducedPlate]) -> None:
    """Catches noisy field depths that count as confirmed, and measured cells that are overwritten by field depths."""
    space = space_of(reduced)
    field = OptimizedField(_Fog(SMALL.grid, space, SMALL.hidden), OccupancyGrid(space, SMALL.occupancy, RayRange()))
    half = [np.arange(len(plate.grid().pixels)) % 2 == 0 for plate in reduced]
    measured = [true_surface(plate, known) for plate, known in zip(reduced, half, strict=True)]
    continued = [true_surface(plate) for plate in reduced]
    merged = add_field_depths(field, reduced, measured, continued, untracked)
    for surface, stereo, extrapolated in zip(merged, measured, continued, strict=True):
        assert (surface.depths.planes[stereo.known] == stereo.depths.planes[stereo.known]).all()
        assert (surface.depths.planes[~stereo.known] == extrapolated.depths.planes[~stereo.known]).all()
        assert surface.known.all()
        assert ((surface.support > 0) == stereo.known).all(), "rays of each plate end directly before its own lens"
    alone = add_field_depths(field, reduced, measured, measured, untracked)
    assert all((surface.known == stereo.known).all() for surface, stereo in zip(alone, measured, strict=True))


@pytest.mark.parametrize("near", [NEAR, 0.3, MAX_NEAR])
def test_normalized_distance_round_trip(near: float) -> None:
    """Catches a mapping that is not monotonic or not continuous between its linear half and its disparity half."""
    normalized, span = torch.linspace(0, 1, 301), RayRange(near)
    distance = span.to_distance(normalized)
    assert distance[0] == pytest.approx(near)
    assert (distance.diff() > 0).all()
    torch.testing.assert_close(span.to_normalized(distance), normalized, atol=1e-5, rtol=0)
    assert span.to_normalized(torch.tensor([0.0, 1e9])).tolist() == pytest.approx([0, 1], abs=1e-2)


def test_rays_start_at_the_near_plane_or_later() -> None:
    """Catches a near plane in world units that is taken as a multiple of the radius, rays that start before NEAR, and
    rays without samples at all."""
    starts = [RayRange.from_near_plane(near, 2.0).near for near in (None, 0.01, 0.6, 50.0)]
    assert starts == pytest.approx([NEAR, NEAR, 0.3, MAX_NEAR])


def test_the_field_has_nothing_before_the_near_plane(reduced: list[ReducedPlate]) -> None:
    """Catches a field that ignores the start of the rays: an opaque field is then seen directly before the lens."""
    space = space_of(reduced)
    for start in (NEAR, 0.4):
        occupancy = OccupancyGrid(space, SMALL.occupancy, RayRange(start))
        field = OptimizedField(_Fog(SMALL.grid, space, SMALL.hidden), occupancy)
        rendered = field.render(camera_rays(reduced[0].camera, torch.tensor([[10.5, 10.5]])), 32)
        first = occupancy.span.to_distance(rendered.edges)[0, 0]
        assert start <= first < start + 0.2


def test_points_on_rays_project_to_their_pixels(rng: np.random.Generator) -> None:
    """Catches half-pixel errors, and camera coordinates mistaken for world coordinates."""
    camera = room_cameras(3)[1]
    positions = torch.from_numpy(rng.uniform((0, 0), (camera.width, camera.height), (20, 2)))
    rays = camera_rays(camera, positions)
    xyz = rays.at(torch.full((20, 1), 1.5), 2.0)[:, 0].numpy()
    pixels, depth = camera.project(xyz.astype(np.float64))
    np.testing.assert_allclose(pixels, positions.numpy(), atol=1e-2)
    assert (depth > 0).all()
    np.testing.assert_allclose(np.linalg.norm(xyz - camera.centre, axis=1), 3.0, atol=1e-4)


def test_sampled_rays_belong_to_their_pixels(reduced: list[ReducedPlate]) -> None:
    """Catches pixels that are combined with the camera of another plate, and samples in holes."""
    holed = [replace(plate, seen=np.arange(WIDTH) > 30 + 0 * plate.seen) for plate in reduced]
    space = space_of(reduced)
    surfaces = [true_surface(plate) for plate in reduced]
    batch = pixels_of(holed, surfaces, space).sample(200, generator())
    xyz = batch.rays.at(RayRange().to_distance(batch.surface)[:, None], space.radius)[:, 0].numpy()
    for row in range(200):
        which = int(np.argmin([np.linalg.norm(s.camera.centre - batch.rays.origins[row].numpy()) for s in reduced]))
        pixel, depth = reduced[which].camera.project(xyz[row : row + 1].astype(np.float64))
        column, line = pixel[0].astype(int)
        assert column > 30
        assert reduced[which].rgb[line, column] / 255 == pytest.approx(batch.rgb[row].numpy(), abs=1e-5)
        assert depth[0] == pytest.approx(room_depth(reduced[which].camera)[line, column], rel=0.1)


def test_weights_and_transmittance_sum_to_one(rng: np.random.Generator) -> None:
    """Catches weights in which an interval's own density counts twice or not at all."""
    density, lengths = (torch.from_numpy(rng.uniform(0, 3, (5, 7))) for _ in range(2))
    weights, transmittance = rendering_weights(density, lengths)
    torch.testing.assert_close(weights.sum(1) + transmittance, torch.ones(5, dtype=torch.float64))
    torch.testing.assert_close(weights[:, 0], 1 - torch.exp(-density[:, 0] * lengths[:, 0]))
    torch.testing.assert_close(transmittance, torch.exp(-(density * lengths).sum(1)))


def test_distortion_loss_equals_the_double_sum(rng: np.random.Generator) -> None:
    """Catches a wrong prefix sum in the distortion loss. The expected value is the double sum of eq. 15 of mip-NeRF
    360."""
    edges = torch.from_numpy(np.sort(rng.random((4, 9)), axis=1))
    weights = torch.from_numpy(rng.random((4, 8)))
    middles, lengths = (edges[:, 1:] + edges[:, :-1]) / 2, edges.diff(dim=1)
    distance = (middles[:, :, None] - middles[:, None]).abs()
    expected = (weights[:, :, None] * weights[:, None] * distance).sum((1, 2)) + (weights**2 * lengths).sum(1) / 3
    torch.testing.assert_close(distortion_loss(weights, edges), expected)


def test_weight_quantiles_are_interpolated() -> None:
    """Catches a quantile that is placed at an end of an interval instead of at the interpolated position."""
    edges = torch.linspace(0, 1, 5)[None].repeat(3, 1)
    weights = torch.tensor([[0.0, 1.0, 0.0, 0.0], [0.25, 0.5, 0.25, 0.0], [0.1, 0.1, 0.1, 0.1]])
    assert weight_quantile(weights, edges, 0.5).tolist() == pytest.approx([0.375, 0.375, 1.0])
    assert weight_quantile(weights, edges, 0.25).tolist() == pytest.approx([0.3125, 0.25, 0.625])


def test_edges_follow_the_histogram(rng: np.random.Generator) -> None:
    """Catches edges that are out of order or out of range, and empty bins that get as many edges as full bins."""
    edges = torch.linspace(0, 1, 11)
    weights = torch.zeros(2, 10)
    weights[0, 3] = 1
    weights[1] = 1
    for jitter in (None, torch.from_numpy(rng.random((2, 21)).astype(np.float32))):
        found = resample_edges(edges, weights, 20, jitter)
        assert (found.diff(dim=1) >= 0).all()
        assert ((found[0] >= 0.3 - 1e-6) & (found[0] <= 0.4 + 1e-6)).all()
        assert found[1, 0] < 0.06
        assert found[1, -1] > 0.94


def one_ray() -> Rays:
    """One ray from (-1, 0, 0) along the x axis."""
    return Rays(torch.tensor([[-1.0, 0, 0]]), torch.tensor([[1.0, 0, 0]]))


def test_samples_concentrate_on_occupied_cells() -> None:
    """Catches too many samples in empty space. Also catches empty space without samples, in which new surfaces would
    not be found."""
    grid = OccupancyGrid(Contraction((0.0, 0.0, 0.0), 1.0), 64, RayRange())
    place = torch.tensor([[0.3, 0.0, 0.0]])
    even = RayRange().to_distance(grid.sample(one_ray(), 32, None)[0])
    grid.update(place, torch.tensor([200.0]))
    found = RayRange().to_distance(grid.sample(one_ray(), 32, None)[0])
    assert ((even - 1.3).abs() < 0.15).sum() < 5
    assert ((found - 1.3).abs() < 0.15).sum() > 16
    assert (found < 1.0).any()
    assert (found > 2.0).any()
    hinted = RayRange().to_distance(grid.sample(one_ray(), 32, None, RayRange().to_normalized(torch.tensor([0.6])))[0])
    assert ((hinted - 0.6).abs() < 0.15).sum() > 8
    without_hint = grid.sample(one_ray(), 32, None, torch.tensor([torch.nan]))
    assert torch.equal(without_hint, grid.sample(one_ray(), 32, None))


def test_densities_decay() -> None:
    """Catches cells whose density never decays, and an update with the last density of a batch instead of the largest
    density."""
    grid = OccupancyGrid(Contraction((0.0, 0.0, 0.0), 1.0), 8, RayRange())
    place = torch.tensor([[0.1, 0.1, 0.1], [0.1, 0.1, 0.1], [0.1, 0.1, 0.1]])
    grid.update(place, torch.tensor([1.0, 5.0, 2.0]))
    cell = grid.cell_of(place)[0]
    assert grid.density[cell] == 5
    grid.update(place, torch.zeros(3))
    assert 4 < grid.density[cell] < 5
    assert (grid.density > 0).sum() == 1


def test_clamped_density_has_a_gradient() -> None:
    """Catches a clamp with a zero gradient. Opaque regions could then never become transparent."""
    log_density = torch.tensor([20.0, 0.5], requires_grad=True)
    bounded_exp(log_density).sum().backward()
    assert log_density.grad is not None
    assert log_density.grad.tolist() == pytest.approx([float(np.exp(11.0)), float(np.exp(0.5))], rel=1e-4)


def test_room_depth_is_interpolated_along_the_horizon(reduced: list[ReducedPlate]) -> None:
    """Catches unmeasured walls that bend towards the floor below them."""
    surfaces = []
    for index, plate in enumerate(reduced):
        known = plate.grid().pixels[:, 0] < (WIDTH if index % 2 else WIDTH // 2)
        surfaces.append(true_surface(plate, known))
    room = RoomShape.from_surfaces(surfaces, np.array([0.3, 0.3, 0.9]))
    assert room is not None
    for plate, surface in zip(reduced[::2], surfaces[::2], strict=True):
        ratio = room.surface_inverse_depths(surface) * room_depth(plate.camera)[plate.grid().indices]
        assert np.median(np.abs(ratio - 1)) < 0.03
        assert np.percentile(np.abs(ratio - 1), 90) < 0.2
    few = [replace(surface, known=np.arange(len(surface.known)) % 100 == 0) for surface in surfaces]
    hall = RoomShape.from_surfaces(few, np.array([0.3, 0.3, 0.9]))
    assert hall is not None
    for plate, surface in zip(reduced, few, strict=True):
        distance = np.linalg.norm(plate.camera.centre - (0.3, 0.3, 0.9))
        assert (hall.surface_inverse_depths(surface) * distance < 3).all(), "no surface close to a lens"
    unknown = [replace(surface, known=np.zeros_like(surface.known)) for surface in surfaces]
    assert RoomShape.from_surfaces(unknown, np.zeros(3)) is None


def plates_of(reduced: list[ReducedPlate]) -> list[PlateView]:
    return [PlateView(f"{index:02d}", plate.camera, plate.rgb, plate.seen) for index, plate in enumerate(reduced)]


def test_blank_walls_are_refused(reduced: list[ReducedPlate]) -> None:
    """Catches an optimisation that starts without any depths, and an empty background that is returned without an
    error."""
    blank = [replace(plate, rgb=np.full_like(plate.rgb, 200)) for plate in plates_of(reduced)]
    with pytest.raises(
        UserError, match=r"plates: expected at least 8 features .*, got 0; .*--background FILE.ply"
    ) as caught:
        seed_from_radiance(blank, reconstruct_surfaces(blank, 0, 1, untracked), 1000, SMALL)
    assert "\n" not in str(caught.value)


def test_too_few_confirmed_depths_are_an_error(reduced: list[ReducedPlate]) -> None:
    """Catches a background made from fog that has consistent depths in all plates. Also catches missing depths that are
    not reported."""
    few = [true_surface(plate, np.arange(len(plate.grid().pixels)) % 400 == 0) for plate in reduced]
    lines: list[str] = []
    config = replace(SMALL, steps=2)
    with pytest.raises(UserError, match=r"at least 1% .* that two plates confirm, got 0\.\d%; .*--background FILE"):
        seed_from_radiance(plates_of(reduced), StereoResult(20, 20, reduced, few), 500, config, log=lines.append)
    assert "too few depths to supervise the field" in lines[1]


def test_the_field_is_fitted_from_the_near_plane(reduced: list[ReducedPlate], monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a near plane that is not passed on to the rays of the field."""

    class _Stop(Exception):
        pass

    spans: list[RayRange] = []

    def record(pixels: Pixels, *_: object) -> OptimizedField:
        spans.append(pixels.span)
        raise _Stop

    monkeypatch.setattr("fourd.reconstruction.background.radiance.from_radiance.optimize_field", record)
    radius = space_of(reduced).radius
    stereo = StereoResult(20, 20, reduced, [true_surface(plate) for plate in reduced])
    for near in (None, 0.2 * radius):
        with pytest.raises(_Stop):
            seed_from_radiance(plates_of(reduced), stereo, 100, SMALL, near=near)
    assert [span.near for span in spans] == pytest.approx([NEAR, 0.2])


@pytest.mark.parametrize(("count", "points"), [(1, 10), (3, 0)])
def test_invalid_arguments(reduced: list[ReducedPlate], count: int, points: int) -> None:
    """Catches invalid arguments without an error that names the expected values."""
    with pytest.raises(ValueError, match="expected at least 2 plates and 1 point"):
        seed_from_radiance(plates_of(reduced)[:count], StereoResult(0, 0, [], []), points, SMALL)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"levels": 0}, "levels: expected 1 to 32, got 0"),
        ({"steps": 0}, "steps: expected at least 1, got 0"),
        ({"measured": -1.0}, "measured: expected 0 or more, got -1.0"),
        ({"rate": float("nan")}, "rate: expected 0 or more, got nan"),
    ],
)
def test_invalid_settings_are_refused(change: dict[str, float], message: str) -> None:
    """Catches an invalid setting that raises an error only during optimisation."""
    with pytest.raises(ValueError, match=message):
        replace(RadianceConfig(), **change)  # type: ignore[arg-type]


def to_walls(xyz: np.ndarray) -> np.ndarray:
    """(N,) distance to the nearest face of the room."""
    x, y, z = np.abs(xyz.astype(np.float64).T)
    return np.min([np.abs(x - 2.0), np.abs(y - 2.0), z, np.abs(z - 2.4)], axis=0)


@pytest.mark.slow
def test_points_of_a_room(rng: np.random.Generator) -> None:
    """Catches stages whose inputs and outputs do not match, and extrapolated points that are not reported."""
    room = Room(np.random.default_rng(3))
    cameras: list[Camera] = room_cameras(3, 144, 108)
    plates = [
        PlateView(f"{i}", camera, room.picture(camera), np.ones((108, 144), bool)) for i, camera in enumerate(cameras)
    ]
    lines: list[str] = []
    stereo = reconstruct_surfaces(plates, 0, 1, untracked)
    found = seed_from_radiance(plates, stereo, 1500, replace(SMALL, steps=150), log=lines.append)
    assert 1200 <= len(found.xyz) <= 1500
    distance = to_walls(found.xyz)
    assert np.median(distance) < 0.01
    assert np.percentile(distance, 90) < 0.15
    assert lines[0].startswith("stereo: ")
    assert f"points: {len(found.xyz)}, " in lines[1]
    assert "extrapolated where only one plate sees the surface" in lines[1]
