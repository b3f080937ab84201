"""The shading kernel against NumPy, and NumPy against the torch model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from fourd.baking.scene import BakedFrame
from fourd.baking.shade import select_source_views, shade, shade_reference
from fourd.model import spherical_harmonics as harmonics
from fourd.ops.shade.reference import sh_basis
from tests.baking.scenes import manifest, random_frame, ring


@pytest.mark.parametrize(("points", "views"), [(0, 6), (1, 6), (17, 1), (1000, 6), (4099, 9), (300, 0)])
def test_kernel_equals_numpy(points: int, views: int) -> None:
    """Catches wrong half-float conversion, block remainders, views mixed up."""
    frame = random_frame(points, views, seed=points + views)
    described = manifest(views=views, frames=1)
    for camera in ring(5):
        got = shade(frame, camera, described)
        assert got.shape == (points, 3)
        assert np.abs(got - shade_reference(frame, camera, described)).max(initial=0) < 2e-5


def test_the_same_bits_for_any_number_of_threads() -> None:
    """Catches pictures that differ between machines."""
    frame, described, camera = random_frame(5000, 6, seed=3), manifest(views=6), ring(7)[3]
    one = shade(frame, camera, described, threads=1)
    assert all(np.array_equal(one, shade(frame, camera, described, threads=count)) for count in (2, 3, 5))


def test_views_without_a_say() -> None:
    """Catches a division by zero where no chosen view has weight: they count evenly then."""
    frame = random_frame(10, 6, seed=1)
    silent = BakedFrame(
        frame.xyz, frame.radius, frame.density, np.zeros_like(frame.sh), np.zeros_like(frame.blend_weights), frame.rgb
    )
    described = manifest(views=6)
    camera = ring(6)[2]
    expected = frame.rgb[:, select_source_views(camera, described)].mean(axis=1) / 255
    assert np.abs(shade(silent, camera, described) - expected).max() < 1e-5


def test_weights_are_relative() -> None:
    """Catches weights that are not normalised over the chosen views."""
    frame, described, camera = random_frame(100, 6, seed=2), manifest(views=6), ring(6)[1]
    twice = replace(frame, blend_weights=frame.blend_weights * np.float16(2))
    assert np.abs(shade(frame, camera, described) - shade(twice, camera, described)).max() < 1e-3


def test_harmonics_are_those_of_training(rng: np.random.Generator) -> None:
    """Catches two tables of constants that drift apart."""
    directions = rng.normal(size=(200, 3))
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    trained = harmonics.sh_basis(torch.from_numpy(directions)).numpy()
    assert np.abs(sh_basis(directions) - trained).max() < 1e-5
