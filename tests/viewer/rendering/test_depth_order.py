"""Display settings, depth orders of points, and the choice of the renderer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.scene import BakedFrame, SceneReader
from fourd.scene.depth_order import DepthSorter
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.depth_order import BackgroundOrders, DepthOrder, ExactOrders
from fourd.viewer.rendering.renderers import RENDERERS, RendererName, choose_renderer
from tests.baking.scenes import manifest, random_frame, ring, write_scene

VIEWS = 2
MANIFEST = manifest(VIEWS)
CAMERAS = ring(5, radius=0.8)


def make_request(camera: int = 0, frame: BakedFrame | None = None) -> RenderRequest:
    """A render request for one of the cameras. The cameras are so close to the points that many points are outside the
    image."""
    return RenderRequest(
        random_frame(500, VIEWS, seed=1) if frame is None else frame, CAMERAS[camera], MANIFEST, DisplaySettings()
    )


def exact_order(request: RenderRequest) -> NDArray[np.uint32]:
    return DepthSorter().sort(request.frame, request.camera, MANIFEST.near)


def is_current(order: DepthOrder, request: RenderRequest) -> bool:
    return order.frame is request.frame and order.camera is request.camera


def eventually(condition: Callable[[], bool]) -> None:
    """Wait for other threads until the condition holds."""
    for _ in range(500):
        if condition():
            return
        time.sleep(0.002)
    raise AssertionError("the condition never held")


def assert_orders(order: DepthOrder, request: RenderRequest) -> None:
    """Assert that ``order`` belongs to ``request`` and contains all visible points, nearest first."""
    assert is_current(order, request)
    visible = exact_order(request)
    assert 0 < len(visible) < request.frame.point_count
    np.testing.assert_array_equal(order.points[np.isin(order.points, visible)], visible)
    assert len(np.unique(order.points)) == len(order.points)
    depths = request.camera.project(request.frame.xyz)[1][order.points]
    assert (np.diff(depths) > -1e-5).all()
    assert order.seconds >= 0


@pytest.fixture
def orders() -> Iterator[BackgroundOrders]:
    made = BackgroundOrders()
    yield made
    made.release()


def test_scales_of_1_return_the_same_frame() -> None:
    """Catches arrays that are copied, and therefore uploaded again for every image, although no scale is set."""
    frame = random_frame(20, VIEWS, seed=2)
    assert DisplaySettings(layers=3, background=(1, 0, 0)).scale_points(frame) is frame


def test_scales_change_only_radii_and_densities() -> None:
    """Catches scales that change the wrong array, densities above 1, and radii that overflow to infinity."""
    frame = random_frame(200, VIEWS, seed=2)
    frame.radius[:3] = (0.0, 0.5, 60000.0)
    scaled = DisplaySettings(point_scale=2.0, density_scale=1.5).scale_points(frame)
    assert scaled.radius.dtype == scaled.density.dtype == np.float16
    np.testing.assert_allclose(scaled.radius[3:], 2.0 * frame.radius[3:], rtol=1e-3)
    assert scaled.radius[:3].tolist() == [0.0, 1.0, 65504.0]
    np.testing.assert_allclose(scaled.density, np.minimum(1.5 * frame.density.astype(float), 1), rtol=1e-3)
    assert scaled.density.max() == 1
    for name in ("xyz", "sh", "blend_weights", "rgb"):
        assert getattr(scaled, name) is getattr(frame, name)
    np.testing.assert_array_equal(frame.radius[3:], random_frame(200, VIEWS, seed=2).radius[3:])


def test_each_scale_works_alone() -> None:
    """Catches a scale that has an effect only if both scales are set, and rounding of the array that is not scaled."""
    frame = random_frame(50, VIEWS, seed=3)
    larger, denser = (
        DisplaySettings(point_scale=0.5).scale_points(frame),
        DisplaySettings(density_scale=0.5).scale_points(frame),
    )
    np.testing.assert_array_equal(larger.density, frame.density)
    np.testing.assert_array_equal(denser.radius, frame.radius)
    np.testing.assert_array_equal(larger.radius, frame.radius / 2)
    np.testing.assert_array_equal(denser.density, frame.density / 2)


@pytest.mark.parametrize("wait", [True, False])
def test_exact_orders_match_the_request(wait: bool) -> None:
    """Catches a depth order that is reused for another frame or camera."""
    frames = [random_frame(points, VIEWS, seed=points) for points in (500, 300)]
    orders = ExactOrders()
    for camera, frame in [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]:
        request = make_request(camera, frames[frame])
        order = orders.order(request, wait)
        assert is_current(order, request)
        np.testing.assert_array_equal(order.points, exact_order(request))


def test_exact_orders_sort_once() -> None:
    """Catches points that are sorted again for an unchanged view, or after a change of display settings."""
    request, orders = make_request(), ExactOrders()
    order = orders.order(request, True)
    assert orders.order(request, False) is order
    assert orders.order(replace(request, settings=DisplaySettings(layers=3)), False) is order
    assert orders.order(replace(request, camera=replace(request.camera)), False) is not order
    orders.release()
    assert orders.order(request, False) is not order


def test_an_order_stays_valid_after_the_next_sort() -> None:
    """Catches indices that are stored in memory that the next sort overwrites while the points are drawn."""
    orders = ExactOrders()
    first = orders.order(make_request(0), True)
    kept = first.points.copy()
    orders.order(make_request(1), True)
    np.testing.assert_array_equal(first.points, kept)


def test_frames_of_a_file_are_sorted(tmp_path: Path, orders: BackgroundOrders) -> None:
    """Catches a sorter that requires writable arrays. The arrays of a scene file are read-only."""
    write_scene(tmp_path / "scene.4dv", views=VIEWS)
    reader = SceneReader(tmp_path / "scene.4dv")
    request = RenderRequest(reader.read(1), CAMERAS[2], reader.manifest, DisplaySettings())
    np.testing.assert_array_equal(ExactOrders().order(request, True).points, exact_order(request))
    assert_orders(orders.order(request, True), request)
    reader.close()


def test_waiting_returns_the_order_of_the_request(orders: BackgroundOrders) -> None:
    """Catches a screenshot or video that is drawn with the depth order of the previous image."""
    frames = [random_frame(points, VIEWS, seed=points) for points in (500, 300)]
    for number in range(30):
        request = make_request(number % 5, frames[number // 3 % 2])
        assert_orders(orders.order(request, True), request)


def test_the_first_order_is_that_of_the_request(orders: BackgroundOrders) -> None:
    """Catches a first image without points, or a crash, because no depth order exists before the first image."""
    request = make_request()
    assert_orders(orders.order(request, False), request)


def test_background_orders_include_points_around_the_image(orders: BackgroundOrders) -> None:
    """Catches holes at the image border while the camera moves and the next depth order is not finished."""
    request = make_request()
    points = orders.order(request, True).points
    pixels, depths = request.camera.project(request.frame.xyz)
    size = request.camera.width
    near = (pixels > -0.5 * size).all(axis=1) & (pixels < 1.5 * size).all(axis=1) & (depths > MANIFEST.near)
    assert near.sum() > len(exact_order(request))
    assert np.isin(np.flatnonzero(near), points).all()


class GatedSorter:
    """A depth sorter that waits for the event ``gate`` before it sorts."""

    gate: ClassVar[threading.Event]
    has_started: ClassVar[threading.Event]
    sorted: ClassVar[list[BakedFrame]]

    def __init__(self) -> None:
        self._sorter = DepthSorter()

    def sort(self, frame: BakedFrame, camera: Camera, near: float) -> NDArray[np.uint32]:
        self.has_started.set()
        assert self.gate.wait(10)
        self.sorted.append(frame)
        return self._sorter.sort(frame, camera, near)


@pytest.fixture
def gated(monkeypatch: pytest.MonkeyPatch) -> type[GatedSorter]:
    """Replace the depth sorter of BackgroundOrders by GatedSorter."""
    GatedSorter.gate, GatedSorter.has_started, GatedSorter.sorted = threading.Event(), threading.Event(), []
    GatedSorter.gate.set()
    monkeypatch.setattr("fourd.viewer.gl.depth_order.DepthSorter", GatedSorter)
    return GatedSorter


def test_images_do_not_wait_for_later_orders(gated: type[GatedSorter]) -> None:
    """Catches images that wait for sorting, outdated requests that are sorted, and a depth order that remains
    outdated."""
    requests = [make_request(0, random_frame(100 + number, VIEWS, seed=number)) for number in range(4)]
    orders = BackgroundOrders()
    first = orders.order(requests[0], False)
    gated.gate.clear()
    gated.has_started.clear()
    assert orders.order(requests[1], False) is first
    assert gated.has_started.wait(10)
    assert orders.order(requests[2], False) is first
    assert orders.order(requests[3], False) is first
    gated.gate.set()
    eventually(lambda: is_current(orders.order(requests[3], False), requests[3]))
    assert_orders(orders.order(requests[3], False), requests[3])
    assert [id(frame) for frame in gated.sorted] == [id(requests[number].frame) for number in (0, 1, 3)]
    orders.release()


def test_an_unchanged_request_is_sorted_once(gated: type[GatedSorter]) -> None:
    """Catches a thread that sorts the points of an unchanged request again and again."""
    orders, request = BackgroundOrders(), make_request()
    order = orders.order(request, True)
    for _ in range(10):
        assert orders.order(request, False) is order
        time.sleep(0.002)
    assert len(gated.sorted) == 1
    orders.release()


@pytest.mark.parametrize("has_order", [False, True])
def test_release_stops_the_thread(has_order: bool) -> None:
    """Catches a sorting thread that continues to run after its renderer is released."""
    before = set(threading.enumerate())
    orders = BackgroundOrders()
    assert len(set(threading.enumerate()) - before) == 1
    if has_order:
        orders.order(make_request(), False)
    orders.release()
    assert set(threading.enumerate()) <= before


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("wait", [True, False])
@pytest.mark.parametrize("has_order", [False, True])
def test_an_error_in_the_thread_reaches_the_caller(has_order: bool, wait: bool) -> None:
    """Catches a viewer that waits forever or always uses an old depth order after the sorting thread has failed."""
    orders, request = BackgroundOrders(), make_request()
    if has_order:
        orders.order(request, True)
    bad = replace(request, camera=replace(request.camera, distortion=np.array([0.1, 0, 0, 0])))

    def raised() -> bool:
        try:
            orders.order(bad, wait)
        except RuntimeError as error:
            return "expected an ideal pinhole" in str(error.__cause__)
        return False

    try:
        eventually(raised)
    finally:
        orders.release()


@pytest.mark.parametrize(
    ("requested", "driver", "name"),
    [
        ("auto", None, "cpu"),
        ("auto", "llvmpipe (LLVM 17.0.6, 256 bits)", "cpu"),
        ("auto", "softpipe", "cpu"),
        ("auto", "SwiftShader Device (Subzero)", "cpu"),
        ("auto", "Apple Software Renderer", "cpu"),
        ("auto", "GDI Generic", "cpu"),
        ("auto", "Microsoft Basic Render Driver", "cpu"),
        ("auto", "NVIDIA GeForce RTX 3060/PCIe/SSE2", "sorted"),
        ("auto", "Mesa Intel(R) UHD Graphics 620 (KBL GT2)", "sorted"),
        ("auto", "AMD Radeon RX 6600 (radeonsi, navi23, LLVM 17.0.6)", "sorted"),
        ("cpu", None, "cpu"),
        ("cpu", "NVIDIA GeForce RTX 3060/PCIe/SSE2", "cpu"),
        ("peel", "llvmpipe (LLVM 17.0.6, 256 bits)", "peel"),
        ("sorted", "Apple M2", "sorted"),
        ("dual", "Apple M2", "dual"),
    ],
)
def test_the_chosen_renderer_suits_the_driver(
    requested: RendererName | Literal["auto"], driver: str | None, name: RendererName
) -> None:
    """Catches a choice that ignores the GPU, uses software OpenGL although the CPU kernel is faster, or ignores the
    user's request."""
    choice = choose_renderer(requested, driver)
    assert choice.name == name
    assert choice.reason
    if requested == "auto" and driver is not None:
        assert driver in choice.reason


@pytest.mark.parametrize("requested", [name for name in RENDERERS if name != "cpu"])
def test_a_gl_renderer_without_gl_raises(requested: RendererName) -> None:
    """Catches a requested OpenGL renderer that is silently replaced, or that fails inside OpenGL."""
    with pytest.raises(UserError, match=f"--renderer: expected cpu.*got {requested}; add --renderer cpu"):
        choose_renderer(requested, None)
