"""Colours that depend only on the height, and their extrapolation into a gap."""

from __future__ import annotations

import numpy as np

from fourd.base.formats.ply import ColouredPoints
from fourd.reconstruction.background.height_profile import MIN_SECTORS, SECTORS, height_profile
from fourd.reconstruction.background.shell import build_shell
from fourd.recording.stereo.directions import DirectionGrid, direction_grid
from tests.captures import ring_cameras

CENTRE = np.array([0.2, 0.1, -0.3])
RADIUS = 5.0


def _grid() -> DirectionGrid:
    return direction_grid(ring_cameras(8, 64), CENTRE, 2)


def _azimuth_deg(grid: DirectionGrid) -> np.ndarray:
    local = grid.directions() @ grid.R_world_sphere
    return np.degrees(np.arctan2(local[:, 1], local[:, 0]))


def _stripes(height: np.ndarray) -> np.ndarray:
    """Grey levels of horizontal stripes, four degrees high at the distance of the wall."""
    return 120 + 60 * np.sign(np.sin(2 * np.pi * height / (RADIUS * np.radians(8))))


def _wall(rng: np.random.Generator, gap_deg: float, count: int = 200_000) -> ColouredPoints:
    """A cylinder with stripes around CENTRE. A range of ``gap_deg`` degrees of azimuth has no points."""
    azimuth = rng.uniform(gap_deg / 2, 360 - gap_deg / 2, count)
    height = rng.uniform(-2.5, 2.5, count)
    angle = np.radians(azimuth)
    offset = np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height], axis=-1)
    rgb = np.repeat(_stripes(height)[:, None], 3, axis=1)
    return ColouredPoints((CENTRE + offset).astype(np.float32), rgb.astype(np.uint8))


def test_shell_continues_the_stripes_of_a_wall() -> None:
    """Catches shell points at a coarse spacing, or colours that blur stripes in a gap."""
    rng = np.random.default_rng(3)
    shell = build_shell(_wall(rng, 40), ring_cameras(8, 64), CENTRE)
    offset = shell.xyz - CENTRE
    azimuth = np.degrees(np.arctan2(offset[:, 1], offset[:, 0]))
    inside = (np.abs(azimuth) < 18) & (np.abs(offset[:, 2]) < 2)
    expected = _stripes(offset[inside, 2])
    stripes = np.corrcoef(expected, shell.rgb[inside, 0].astype(float))[0, 1]
    assert stripes > 0.8
    assert np.abs(expected - shell.rgb[inside, 0]).mean() < 25


def test_a_wall_without_stripes_has_no_profile() -> None:
    """Catches a profile of random texture, which would show as false stripes in the shell."""
    grid, rng = _grid(), np.random.default_rng(4)
    known = np.abs(_azimuth_deg(grid)) > 20
    coarse = rng.uniform(0, 255, (grid.rows // 8, grid.columns // 8, 3))
    rgb = np.kron(coarse, np.ones((8, 8, 1))).reshape(-1, 3)
    profile = height_profile(grid, known, np.full(len(known), 1 / RADIUS), rgb)
    assert np.sqrt((profile**2).mean()) < 8
    assert rgb[known].std() > 60


def test_a_pattern_in_few_directions_is_not_extrapolated() -> None:
    """Catches a profile that copies an object, such as one shelf, all around the scene."""
    grid = _grid()
    local = grid.directions() @ grid.R_world_sphere
    sector = np.tile(np.arange(grid.columns), grid.rows) * SECTORS // grid.columns
    known = sector < MIN_SECTORS - 1
    rgb = np.repeat(_stripes(RADIUS * local[:, 2])[:, None], 3, axis=1)
    assert not height_profile(grid, known, np.full(len(known), 1 / RADIUS), rgb).any()
