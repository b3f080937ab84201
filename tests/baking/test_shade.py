"""The shading kernel compared with NumPy, and NumPy compared with the torch model."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from fourd.reconstruction.model import spherical_harmonics
from fourd.rendering.ops.shade.reference import sh_basis
from fourd.scene.shade import select_source_views, shade, shade_reference
from tests.baking.scenes import manifest, random_frame, ring


@pytest.mark.parametrize(("points", "views"), [(0, 6), (1, 6), (17, 1), (1000, 6), (4099, 9), (300, 0)])
def test_kernel_equals_the_reference(points: int, views: int) -> None:
    """Catches a wrong conversion from float16, errors in the last incomplete block of points, and swapped views."""
    frame = random_frame(points, views, seed=points + views)
    described = manifest(views=views, frames=1)
    for camera in ring(5):
        got = shade(frame, camera, described)
        assert got.shape == (points, 3)
        assert np.abs(got - shade_reference(frame, camera, described)).max(initial=0) < 2e-5


def test_any_thread_count_gives_the_same_bits() -> None:
    """Catches colours that depend on the instruction set or the number of threads."""
    frame, described, camera = random_frame(5000, 6, seed=3), manifest(views=6), ring(7)[3]
    one = shade(frame, camera, described, threads=1)
    assert all(np.array_equal(one, shade(frame, camera, described, threads=count)) for count in (2, 3, 5))


def test_points_without_blend_weights_use_the_view_weights() -> None:
    """Catches a division by zero for points whose selected views all have blend weight 0."""
    frame = random_frame(10, 6, seed=1)
    weightless = replace(frame, sh=np.zeros_like(frame.sh), blend_weights=np.zeros_like(frame.blend_weights))
    described = manifest(views=6)
    camera = ring(6)[2]
    views = select_source_views(camera, described)
    assert len(set(views.weights.tolist())) > 1
    expected = np.average(frame.rgb[:, views.indices], axis=1, weights=views.weights) / 255
    assert np.abs(shade(weightless, camera, described) - expected).max() < 1e-5


def test_view_weights_scale_the_blend_weights() -> None:
    """Catches view weights that are ignored, or assigned to the wrong views."""
    frame, camera = random_frame(100, 6, seed=4), ring(29)[1]
    faded, even = manifest(views=6), replace(manifest(views=6), fade_views=False)
    views = select_source_views(camera, faded)
    scaled = frame.blend_weights.copy()
    scaled[:, views.indices] *= views.weights.astype(np.float16)
    expected = shade(replace(frame, blend_weights=scaled), camera, even)
    assert np.abs(shade(frame, camera, faded) - expected).max() < 2e-3
    assert np.abs(shade(frame, camera, even) - expected).max() > 1e-2


def test_colours_do_not_jump_when_the_selected_views_change() -> None:
    """Catches view weights that are not 0 at the angle at which another view replaces the view."""
    frame, described = random_frame(200, 6, seed=5), manifest(views=6)
    path = ring(720)
    selected = [set(select_source_views(camera, described).indices) for camera in path]
    colours = [shade(frame, camera, described) for camera in path]
    steps = np.array([np.abs(after - before).mean() for before, after in pairwise(colours)])
    changes = np.array([before != after for before, after in pairwise(selected)])
    assert changes.sum() >= 4
    assert steps[changes].max() < 1.5 * steps[~changes].max()


def test_weights_are_normalized() -> None:
    """Catches weights that are not normalized over the selected views."""
    frame, described, camera = random_frame(100, 6, seed=2), manifest(views=6), ring(6)[1]
    twice = replace(frame, blend_weights=frame.blend_weights * np.float16(2))
    assert np.abs(shade(frame, camera, described) - shade(twice, camera, described)).max() < 1e-3


def test_harmonics_equal_those_of_training(rng: np.random.Generator) -> None:
    """Catches a basis of spherical harmonics that differs from the basis in training."""
    directions = rng.normal(size=(200, 3))
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    trained = spherical_harmonics.sh_basis(torch.from_numpy(directions)).numpy()
    assert np.abs(sh_basis(directions) - trained).max() < 1e-5
