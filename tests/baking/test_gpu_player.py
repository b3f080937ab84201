"""Frames drawn by the CUDA kernels, compared with the float reference. The kernels run on a GPU or in the emulator."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.scene import SceneReader
from fourd.scene.gpu_player import GpuFrame, GpuPlayer
from fourd.scene.shade import shade_reference
from tests.baking.scenes import NEAR_IN_BALL, manifest, random_frame, ring, write_full_scene
from tests.baking.test_player import draw_reference


@pytest.mark.parametrize(("points", "layers"), [(0, 12), (1, 1), (700, 12), (300, 3)])
def test_bytes_equal_the_float_picture(points: int, layers: int, gpu: torch.device) -> None:
    """Catches swapped channels, and a background that is composited twice."""
    frame, described = random_frame(points, 6, seed=points + layers), manifest(views=6)
    player, held = GpuPlayer(gpu), GpuFrame.from_frame(frame, gpu)
    for camera in ring(2):
        background = (0.2, 0.9, 0.4)
        picture = player.draw(held, camera, described, layers=layers, background=background).cpu().numpy()
        truth = draw_reference(frame, camera, described, layers, background)
        assert picture.shape == truth.shape
        assert np.abs(picture.astype(float) - 255 * truth).max() <= 1.0


def test_points_fade_at_the_near_plane(gpu: torch.device) -> None:
    """Catches a GPU that cuts points off where the CPU fades them."""
    frame, described = random_frame(700, 6, seed=2), replace(manifest(views=6), near=NEAR_IN_BALL)
    for camera in ring(2):
        picture = GpuPlayer(gpu).draw(GpuFrame.from_frame(frame, gpu), camera, described).cpu().numpy()
        truth = draw_reference(frame, camera, described, described.layers)
        assert np.abs(picture.astype(float) - 255 * truth).max() <= 1.0


def test_colours_equal_the_reference(gpu: torch.device) -> None:
    """Catches spherical harmonics in the wrong order, and unequal weights for a point whose blend weights are all 0."""
    frame, described = random_frame(500, 6, seed=3), manifest(views=6)
    frame.blend_weights[:50] = 0
    for camera in ring(3):
        got = GpuPlayer(gpu).shade(GpuFrame.from_frame(frame, gpu), camera, described).cpu().numpy()
        assert np.abs(got - shade_reference(frame, camera, described)).max() <= 1e-5


@pytest.mark.filterwarnings("error")
def test_a_full_scene_from_a_file(gpu: torch.device, tmp_path: Path) -> None:
    """Catches a background that is not drawn, and torch's warning about read-only arrays."""
    write_full_scene(tmp_path / "full.4dv", frames=1, points=300, background_points=400)
    reader, camera = SceneReader(tmp_path / "full.4dv"), ring(2)[1]
    frame = reader.read(0)
    picture = GpuPlayer(gpu).draw(GpuFrame.from_frame(frame, gpu), camera, reader.manifest).cpu().numpy()
    truth = draw_reference(frame, camera, reader.manifest, reader.manifest.layers)
    assert np.abs(picture.astype(float) - 255 * truth).max() <= 1.0
    assert (picture[..., 3] > 128).mean() > 0.9


def test_a_canvas_of_another_shape_is_rejected(gpu: torch.device) -> None:
    """Catches a kernel that writes past the output image."""
    frame, described, camera = random_frame(5, 6, seed=4), manifest(views=6), ring(4)[2]
    with pytest.raises(ValueError, match=r"out: expected contiguous uint8 of shape \(48, 48, 4\), got"):
        out = torch.empty(48, 48, 3, device=gpu)
        GpuPlayer(gpu).draw(GpuFrame.from_frame(frame, gpu), camera, described, out=out)
