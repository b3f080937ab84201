"""Sorting of points by depth, compared with NumPy."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Barrier

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.base.cameras import Camera
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.play.reference import sort_points_reference
from fourd.scene import BakedFrame
from fourd.scene.depth_order import DepthSorter
from tests.baking.scenes import random_frame, ring

NEAR = 0.5


def straight_camera(width: int = 40, height: int = 30) -> Camera:
    """Return a camera at (0, 0, -2) that views along z, so that points of equal z have equal depths."""
    intrinsics = np.array([[35.0, 0.2, width / 2 + 0.3], [0, 34.0, height / 2 - 0.4], [0, 0, 1]])
    return Camera(intrinsics, np.eye(3), np.array([0.0, 0, 2]), width, height)


def turned_camera() -> Camera:
    """Return a camera rotated about all three axes."""
    rotation = Rotation.from_euler("xyz", [0.3, -0.4, 0.2]).as_matrix()
    return replace(straight_camera(33, 47), rotation=rotation, translation=np.array([0.1, -0.2, 1.5]))


def hard_frame(points: int, seed: int) -> BakedFrame:
    """Return points with equal depths, points at the borders of the view or outside it, and invalid points."""
    rng = np.random.default_rng(seed)
    frame = random_frame(points, 1, seed)
    xyz = rng.uniform([-2.5, -2.5, -2.5], [2.5, 2.5, 2.5], (points, 3)).astype(np.float32)
    radius = np.exp(rng.uniform(np.log(0.002), np.log(0.5), points)).astype(np.float16)
    density = frame.density.copy()
    kind = rng.integers(0, 18, points)
    spoilt = np.array([np.nan, np.inf, -np.inf], np.float32)
    xyz[kind < 4, 2] = np.round(4 * xyz[kind < 4, 2]) / 4
    xyz[kind == 4] = xyz[kind == 4][:1]
    xyz[kind == 5, 2] = np.float32(NEAR - 2) + rng.choice([-1e-6, 0, 1e-6], (kind == 5).sum()).astype(np.float32)
    xyz[kind == 6, rng.integers(0, 3)] = rng.choice(spoilt, (kind == 6).sum())
    xyz[kind == 7] *= np.float32(1e38)
    radius[kind == 8] = 0
    radius[kind == 9] = -0.1
    radius[kind == 10] = 30.0
    density[kind == 11] = 0
    density[kind == 12] = -0.5
    density[kind == 13] = 3.0
    return replace(frame, xyz=xyz, radius=radius, density=density)


def sort_reference(frame: BakedFrame, camera: Camera, near: float) -> NDArray[np.uint32]:
    return sort_points_reference(frame.xyz, frame.radius, frame.density, camera, near)


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize("camera", [straight_camera(), turned_camera()], ids=["straight", "turned"])
@pytest.mark.parametrize("points", [0, 1, 9, 3000])
def test_order_equals_a_stable_sort_of_the_visible_points(
    points: int, camera: Camera, simd: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches wrong order of equal depths, wrong culling, and depths rounded differently from the reference."""
    if not load_native().simd_available(simd):
        pytest.skip(f"{simd} is not available here")
    monkeypatch.setenv("FOURD_SIMD", simd)
    frame = hard_frame(points, seed=points)
    order = DepthSorter().sort(frame, camera, NEAR)
    assert order.dtype == np.uint32
    np.testing.assert_array_equal(order, sort_reference(frame, camera, NEAR))


@pytest.mark.parametrize("threads", [1, 2, 3, 7, 32])
@pytest.mark.parametrize("points", [5, 20_000])
def test_any_thread_count_gives_the_same_order(points: int, threads: int) -> None:
    """Catches sorted chunks that are joined in the wrong order, and errors from empty chunks."""
    frame, camera = hard_frame(points, seed=6), straight_camera()
    order = DepthSorter().sort(frame, camera, NEAR, threads=threads)
    np.testing.assert_array_equal(order, sort_reference(frame, camera, NEAR))


def test_default_thread_count_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a value of FOURD_THREADS that is ignored, and an invalid value that is accepted."""
    frame, camera = hard_frame(3000, seed=7), turned_camera()
    monkeypatch.setenv("FOURD_THREADS", "3")
    np.testing.assert_array_equal(DepthSorter().sort(frame, camera, NEAR), sort_reference(frame, camera, NEAR))
    monkeypatch.setenv("FOURD_THREADS", "many")
    with pytest.raises(ValueError, match="FOURD_THREADS: expected a whole number of at least 1, got 'many'"):
        DepthSorter().sort(frame, camera, NEAR)


def test_equal_depths_are_sorted_by_index() -> None:
    """Catches an order of coplanar points that changes between images."""
    frame = random_frame(5000, 1, seed=8)
    frame.xyz[:] = np.random.default_rng(8).uniform(-0.3, 0.3, frame.xyz.shape)
    frame.xyz[:, 2] = np.float32(0.125) * (np.arange(5000) % 3)
    frame.radius[:] = 0.1
    order = DepthSorter().sort(frame, straight_camera(), NEAR)
    index = np.arange(5000)
    np.testing.assert_array_equal(order, np.concatenate([index[index % 3 == plane] for plane in range(3)]))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("xyz", (0, 0, -2 + 0.99 * NEAR)),
        ("xyz", (0, 0, -3)),
        ("xyz", (5, 0, 0)),
        ("xyz", (0, -5, 0)),
        ("xyz", (np.nan, 0, 0)),
        ("xyz", (0, 0, np.inf)),
        ("radius", 0),
        ("radius", -1),
        ("density", 0),
        ("density", -1),
    ],
)
def test_culled_points_are_left_out(name: str, value: float | tuple[float, ...]) -> None:
    """Catches an error in any single culling condition. The culled point lies between two visible points."""
    frame = random_frame(3, 1, seed=9)
    frame.xyz[:] = [[0, 0, 0.2], [0, 0, 0.1], [0, 0, 0]]
    assert DepthSorter().sort(frame, straight_camera(), NEAR).tolist() == [2, 1, 0]
    getattr(frame, name)[1] = value
    assert DepthSorter().sort(frame, straight_camera(), NEAR).tolist() == [2, 0]


def test_a_disc_that_overlaps_the_border_is_kept() -> None:
    """Catches culling by the centres of discs, which removes discs at the image border."""
    frame = random_frame(2, 1, seed=10)
    frame.xyz[:] = [[2, 0, 0], [0, 0, 0]]
    frame.radius[:] = (1.5, 0.05)
    assert sorted(DepthSorter().sort(frame, straight_camera(), NEAR).tolist()) == [0, 1]


def test_an_order_does_not_depend_on_the_frame_before() -> None:
    """Catches workspace data of a larger frame that leaks into the next result, and results that the next call
    overwrites."""
    sorter, camera = DepthSorter(), ring(4)[1]
    frames = [random_frame(points, 1, seed=points) for points in (3000, 40, 0, 5000)]
    orders = [sorter.sort(frame, camera, NEAR) for frame in frames]
    for frame, order in zip(frames, orders, strict=True):
        np.testing.assert_array_equal(order, sort_reference(frame, camera, NEAR))


def test_invalid_arguments_are_named() -> None:
    """Catches a sorter that accepts a camera with lens distortion or a near plane behind the camera."""
    frame, camera, sorter = random_frame(5, 1, seed=11), straight_camera(), DepthSorter()
    for near in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="near: expected a finite distance above 0"):
            sorter.sort(frame, camera, near)
    with pytest.raises(ValueError, match="camera: expected an ideal pinhole"):
        sorter.sort(frame, replace(camera, distortion=np.array([0.1, 0, 0, 0])), NEAR)
    with pytest.raises(ValueError, match="threads: expected 0"):
        sorter.sort(frame, camera, NEAR, threads=-1)


def test_threads_that_share_a_sorter_take_turns() -> None:
    """Catches two simultaneous calls on one native workspace, which corrupt memory."""
    sorter, camera = DepthSorter(), straight_camera()
    frames = [hard_frame(100 * 5**index, seed=index) for index in range(4)]
    expected = [sort_reference(frame, camera, NEAR) for frame in frames]
    start = Barrier(4)

    def sort(worker: int) -> list[bool]:
        start.wait(10)
        chosen = [(worker + round_) % 4 for round_ in range(60)]
        return [np.array_equal(sorter.sort(frames[k], camera, NEAR), expected[k]) for k in chosen]

    with ThreadPoolExecutor(4) as pool:
        assert all(all(same) for same in pool.map(sort, range(4)))
