"""Frames drawn as bytes against the float renderer."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.baking.attributes import ATTRIBUTES
from fourd.baking.player import Player
from fourd.baking.scene import BakedFrame
from fourd.baking.shade import shade_reference
from fourd.cameras import Camera
from fourd.ops.loading import load_native
from fourd.ops.points.arrays import render_points_numpy
from tests.baking.scenes import manifest, random_frame, ring


def expected(frame, camera: Camera, described, layers: int, background: tuple[float, float, float]) -> np.ndarray:
    """Colour and alpha (H, W, 4) in [0, 1], in floats and without ends before the last layer."""
    colour, alpha, _ = render_points_numpy(
        frame.xyz,
        shade_reference(frame, camera, described),
        frame.radius.astype(np.float32),
        frame.density.astype(np.float32),
        camera,
        layers=layers,
        near=described.near,
        background=np.asarray(background, np.float32),
    )
    return np.concatenate([np.clip(colour, 0, 1), alpha[..., None]], axis=2)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize(("points", "layers"), [(0, 12), (1, 1), (3000, 12), (700, 3)])
def test_bytes_equal_the_float_picture(points: int, layers: int, simd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches channels in another order, a background added twice, and blocks stored where others belong."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    frame, described = random_frame(points, 6, seed=points + layers), manifest(views=6)
    player = Player()
    for camera in ring(3):
        background = (0.2, 0.9, 0.4)
        picture = player.draw(frame, camera, described, layers=layers, background=background)
        truth = expected(frame, camera, described, layers, background)
        assert picture.shape == truth.shape
        assert np.abs(picture.astype(float) - 255 * truth).max() <= 1.0


def test_a_part_of_a_picture_is_that_part() -> None:
    """Catches points in the picture that are not shaded, or as they were for the camera before."""
    described, whole = manifest(views=6), ring(4)[1].resize(128, 128)
    frame = random_frame(6000, 6, seed=3)
    order = np.argsort(frame.xyz[:, 0], kind="stable")
    arrays = {attribute.name: getattr(frame, attribute.name)[order] for attribute in ATTRIBUTES}
    frame, player = BakedFrame(**arrays), Player()
    player.draw(frame, ring(4)[3].resize(128, 128), described)
    for left, top in ((0, 0), (90, 40), (60, 100)):
        camera = whole.crop(left, top, 20, 24)
        truth = expected(frame, camera, described, described.layers, (0.0, 0.0, 0.0))
        picture = player.draw(frame, camera, described)
        assert np.abs(picture.astype(float) - 255 * truth).max() <= 1.0


def test_a_player_forgets_the_picture_before() -> None:
    """Catches memory kept from a larger scene or picture that shows in the next one."""
    described = manifest(views=6)
    few, many = random_frame(50, 6, seed=1), random_frame(5000, 6, seed=2)
    small, large = ring(4)[0], ring(4)[1].resize(101, 67)
    player, fresh = Player(), Player()
    alone = fresh.draw(few, small, described)
    player.draw(many, large, described)
    assert np.array_equal(player.draw(few, small, described), alone)


def test_drawing_into_an_array_that_is_given() -> None:
    frame, described, camera = random_frame(200, 6, seed=4), manifest(views=6), ring(4)[2]
    player = Player()
    out = np.full((camera.height, camera.width, 4), 7, np.uint8)
    assert player.draw(frame, camera, described, out=out) is out
    assert np.array_equal(out, player.draw(frame, camera, described, threads=3))
    with pytest.raises(ValueError, match=r"out: expected contiguous uint8 of shape .*, got float32"):
        player.draw(frame, camera, described, out=out.astype(np.float32))
    with pytest.raises(ValueError, match="layers: expected at least 1, got 0"):
        player.draw(frame, camera, described, layers=0)
