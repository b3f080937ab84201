"""Frames drawn as 8-bit images, compared with the float reference."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.pixel_filter.op import filter_pixels
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference
from fourd.rendering.ops.play.reference import draw_points_reference
from fourd.scene.player import Player
from fourd.scene.scene import BakedFrame, SceneManifest, make_frame
from fourd.scene.shade import make_shading
from tests.baking.scenes import manifest, random_frame, ring

BLACK = (0.0, 0.0, 0.0)


def draw_reference(
    frame: BakedFrame,
    camera: Camera,
    described: SceneManifest,
    layers: int,
    background: tuple[float, float, float] = BLACK,
) -> NDArray[np.float32]:
    """Return colour and alpha (H, W, 4) in [0, 1]."""
    image = draw_points_reference(
        frame.xyz,
        frame.radius,
        frame.density,
        frame.sh,
        frame.blend_weights,
        frame.rgb,
        make_shading(camera, described),
        camera,
        layers=layers,
        near=described.near,
        background=background,
    )
    return filter_pixels_reference(image, described.pixel_filter)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize(("points", "layers"), [(0, 12), (1, 1), (3000, 12), (700, 3)])
def test_bytes_equal_the_float_picture(points: int, layers: int, simd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches swapped channels, a background added twice, and tiles at the wrong position in the image."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    frame, described = random_frame(points, 6, seed=points + layers), manifest(views=6)
    player = Player()
    for camera in ring(3):
        background = (0.2, 0.9, 0.4)
        picture = player.draw(frame, camera, described, layers=layers, background=background)
        truth = draw_reference(frame, camera, described, layers, background)
        assert picture.shape == truth.shape
        assert np.abs(picture.astype(float) - 255 * truth).max() <= 1.0


@pytest.mark.parametrize("size", [(1, 1), (16, 33), (101, 67), (150, 131)])
@pytest.mark.parametrize("points", [0, 1, 3, 2000])
def test_a_filtered_picture_is_the_filter_of_the_unfiltered_one(
    points: int, size: tuple[int, int], rng: np.random.Generator
) -> None:
    """Catches a filter that skips pixels beside the points, or that reads rows which it has already replaced. Points
    that cover a few tiles and images of several bands of rows are filtered in parts."""
    seed = int(rng.integers(1 << 30))
    print(f"seed {seed}")
    frame, described = random_frame(points, 6, seed=seed), manifest(views=6)
    player = Player()
    for camera in ring(3):
        for threads in (1, 3):
            options = {"background": (0.2, 0.9, 0.4), "threads": threads}
            plain = player.draw(frame, camera.resize(*size), replace(described, pixel_filter=0.0), **options)
            filtered = player.draw(frame, camera.resize(*size), replace(described, pixel_filter=0.2), **options)
            np.testing.assert_array_equal(filtered, filter_pixels(plain, 0.2))


def test_a_crop_of_the_camera_draws_that_part() -> None:
    """Catches visible points that are not shaded, or that keep their colours from the previous camera."""
    described, whole = manifest(views=6), ring(4)[1].resize(128, 128)
    frame = random_frame(6000, 6, seed=3)
    order = np.argsort(frame.xyz[:, 0], kind="stable")
    frame = make_frame({name: array[order] for name, array in frame.arrays.items()})
    player = Player()
    player.draw(frame, ring(4)[3].resize(128, 128), described)
    for left, top in ((0, 0), (90, 40), (60, 100)):
        camera = whole.crop(left, top, 20, 24)
        truth = draw_reference(frame, camera, described, described.layers)
        picture = player.draw(frame, camera, described)
        assert np.abs(picture.astype(float) - 255 * truth).max() <= 1.0


def test_a_picture_does_not_depend_on_the_one_before() -> None:
    """Catches workspace data of a larger scene or image that leaks into the next image."""
    described = manifest(views=6)
    few, many = random_frame(50, 6, seed=1), random_frame(5000, 6, seed=2)
    small, large = ring(4)[0], ring(4)[1].resize(101, 67)
    player, fresh = Player(), Player()
    alone = fresh.draw(few, small, described)
    player.draw(many, large, described)
    assert np.array_equal(player.draw(few, small, described), alone)


def test_drawing_into_a_given_array() -> None:
    """Catches an image that is drawn into a copy of ``out``. Also catches a player that accepts an ``out`` of the wrong
    size or dtype."""
    frame, described, camera = random_frame(200, 6, seed=4), manifest(views=6), ring(4)[2]
    player = Player()
    out = np.full((camera.height, camera.width, 4), 7, np.uint8)
    assert player.draw(frame, camera, described, out=out) is out
    assert np.array_equal(out, player.draw(frame, camera, described, threads=3))
    with pytest.raises(ValueError, match=r"out: expected contiguous uint8 of shape .*, got float32"):
        player.draw(frame, camera, described, out=out.astype(np.float32))
    with pytest.raises(ValueError, match="layers: expected at least 1, got 0"):
        player.draw(frame, camera, described, layers=0)


def test_threads_that_share_a_player_take_turns() -> None:
    """Catches two simultaneous calls on one native workspace. Each image has a different size, so that the buffers are
    reallocated."""
    described, player = manifest(views=6), Player()
    frames = [random_frame(300 * 4**index, 6, seed=index) for index in range(4)]
    cameras = [ring(4)[index].resize(40 * (index + 1), 30 * (index + 1)) for index in range(4)]
    expected = [Player().draw(frame, camera, described) for frame, camera in zip(frames, cameras, strict=True)]
    start = Barrier(4)

    def draw(worker: int) -> list[bool]:
        start.wait(10)
        chosen = [(worker + round_) % 4 for round_ in range(40)]
        return [np.array_equal(player.draw(frames[k], cameras[k], described), expected[k]) for k in chosen]

    with ThreadPoolExecutor(4) as pool:
        assert all(all(same) for same in pool.map(draw, range(4)))


def test_large_discs_need_little_memory() -> None:
    """Catches memory that is proportional to the number of pairs of a disc and a tile. With discs that cover the image,
    a small file would then need gigabytes. Also catches wrong pixels where the image is drawn in bands.
    """
    points, side = 8000, 1600
    frame, scene = random_frame(points, 2, seed=1), replace(manifest(2, 1), pixel_filter=0.0)
    frame = replace(frame, radius=np.full(points, 20, np.float16), density=(0.02 * frame.density).astype(np.float16))
    camera = scene.source_cameras[0].resize(side, side)
    player = Player()
    image = player.draw(frame, camera, scene)
    assert (side // 16) ** 2 * points > 1 << 26, "the entries of all tiles are more than those of a band"
    half = side // 2
    for top in (0, half):
        intrinsics = camera.intrinsics - np.array([[0, 0, 0], [0, 0, top], [0, 0, 0]])
        part = player.draw(frame, replace(camera, intrinsics=intrinsics, height=half), scene)
        difference = np.abs(image[top : top + half].astype(int) - part)
        assert difference.max() <= 1
