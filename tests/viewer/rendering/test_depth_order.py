"""What is drawn, in which order, and by which renderer."""

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

from fourd.baking import BakedFrame, SceneReader
from fourd.baking.depth_order import DepthSorter
from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.depth_order import BackgroundOrders, DepthOrder, ExactOrders
from fourd.viewer.rendering.renderers import RENDERERS, RendererName, choose_renderer
from tests.baking.scenes import manifest, random_frame, ring, write_scene

VIEWS = 2
MANIFEST = manifest(VIEWS)
CAMERAS = ring(5, radius=0.8)


def shot_of(camera: int = 0, frame: BakedFrame | None = None) -> RenderRequest:
    """A request from one of the cameras, which stand close: many points lie outside their pictures."""
    return RenderRequest(
        random_frame(500, VIEWS, seed=1) if frame is None else frame, CAMERAS[camera], MANIFEST, DisplaySettings()
    )


def exact(request: RenderRequest) -> NDArray[np.uint32]:
    return DepthSorter().sort(request.frame, request.camera, MANIFEST.near)


def fits(order: DepthOrder, request: RenderRequest) -> bool:
    return order.frame is request.frame and order.camera is request.camera


def eventually(condition: Callable[[], bool]) -> None:
    """Let other threads go on until it holds."""
    for _ in range(500):
        if condition():
            return
        time.sleep(0.002)
    raise AssertionError("it never came")


def assert_orders(order: DepthOrder, request: RenderRequest) -> None:
    """The order is the request's: all that it sees is there, nearest first."""
    assert fits(order, request)
    seen = exact(request)
    assert 0 < len(seen) < request.frame.point_count
    np.testing.assert_array_equal(order.points[np.isin(order.points, seen)], seen)
    assert len(np.unique(order.points)) == len(order.points)
    depths = request.camera.project(request.frame.xyz)[1][order.points]
    assert (np.diff(depths) > -1e-5).all()
    assert order.seconds >= 0


@pytest.fixture
def orders() -> Iterator[BackgroundOrders]:
    made = BackgroundOrders()
    yield made
    made.release()


def test_a_look_of_no_scales_gives_the_frame_itself() -> None:
    """Catches arrays that are copied and uploaded again for every picture."""
    frame = random_frame(20, VIEWS, seed=2)
    assert DisplaySettings(layers=3, background=(1, 0, 0)).scale_points(frame) is frame


def test_a_look_scales_radii_and_densities_and_nothing_else() -> None:
    """Catches scales on the wrong array, densities above 1, and radii that overflow to infinity and vanish."""
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


def test_one_scale_alone_leaves_the_other_array() -> None:
    """Catches a scale that is scale_points only where the other is set too, and rounding of what is not scaled."""
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
def test_exact_orders_are_the_shots_own(wait: bool) -> None:
    """Catches an order kept for another frame or camera."""
    frames = [random_frame(points, VIEWS, seed=points) for points in (500, 300)]
    orders = ExactOrders()
    for camera, frame in [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]:
        request = shot_of(camera, frames[frame])
        order = orders.order(request, wait)
        assert fits(order, request)
        np.testing.assert_array_equal(order.points, exact(request))


def test_exact_orders_sort_once() -> None:
    """Catches sorting for every picture while nothing moves, and a settings that is taken for a move."""
    request, orders = shot_of(), ExactOrders()
    order = orders.order(request, True)
    assert orders.order(request, False) is order
    assert orders.order(replace(request, settings=DisplaySettings(layers=3)), False) is order
    assert orders.order(replace(request, camera=replace(request.camera)), False) is not order
    orders.release()
    assert orders.order(request, False) is not order


def test_an_order_outlives_the_next_one() -> None:
    """Catches indices in memory that the next sorting writes over, while they are still drawn."""
    orders = ExactOrders()
    first = orders.order(shot_of(0), True)
    kept = first.points.copy()
    orders.order(shot_of(1), True)
    np.testing.assert_array_equal(first.points, kept)


def test_frames_of_a_file_are_ordered(tmp_path: Path, orders: BackgroundOrders) -> None:
    """Catches a sorter that wants arrays it may write to: those of a file are read-only."""
    write_scene(tmp_path / "scene.4dv", views=VIEWS)
    reader = SceneReader(tmp_path / "scene.4dv")
    request = RenderRequest(reader.read(1), CAMERAS[2], reader.manifest, DisplaySettings())
    np.testing.assert_array_equal(ExactOrders().order(request, True).points, exact(request))
    assert_orders(orders.order(request, True), request)
    reader.close()


def test_waiting_gives_the_shots_own_order(orders: BackgroundOrders) -> None:
    """Catches a screenshot or a video drawn with the order of the picture before."""
    frames = [random_frame(points, VIEWS, seed=points) for points in (500, 300)]
    for number in range(30):
        request = shot_of(number % 5, frames[number // 3 % 2])
        assert_orders(orders.order(request, True), request)


def test_the_first_order_is_the_shots_own(orders: BackgroundOrders) -> None:
    """Catches a first picture without points, or a crash because there is no order yet."""
    request = shot_of()
    assert_orders(orders.order(request, False), request)


def test_points_beside_and_before_the_picture_are_ordered_too(orders: BackgroundOrders) -> None:
    """Catches holes at the border while the viewer turns or moves before the next order comes."""
    request = shot_of()
    points = orders.order(request, True).points
    pixels, depths = request.camera.project(request.frame.xyz)
    size = request.camera.width
    near = (pixels > -0.5 * size).all(axis=1) & (pixels < 1.5 * size).all(axis=1) & (depths > MANIFEST.near)
    assert near.sum() > len(exact(request))
    assert np.isin(np.flatnonzero(near), points).all()


class GatedSorter:
    """The sorter, made to wait."""

    gate: ClassVar[threading.Event]
    begun: ClassVar[threading.Event]
    sorted: ClassVar[list[BakedFrame]]

    def __init__(self) -> None:
        self._sorter = DepthSorter()

    def sort(self, frame: BakedFrame, camera: Camera, near: float) -> NDArray[np.uint32]:
        self.begun.set()
        assert self.gate.wait(10)
        self.sorted.append(frame)
        return self._sorter.sort(frame, camera, near)


@pytest.fixture
def gated(monkeypatch: pytest.MonkeyPatch) -> type[GatedSorter]:
    """Makes BackgroundOrders sort when the gate is open."""
    GatedSorter.gate, GatedSorter.begun, GatedSorter.sorted = threading.Event(), threading.Event(), []
    GatedSorter.gate.set()
    monkeypatch.setattr("fourd.viewer.gl.depth_order.DepthSorter", GatedSorter)
    return GatedSorter


def test_later_orders_are_not_waited_for(gated: type[GatedSorter]) -> None:
    """Catches pictures that wait for sorting, shots that queue up, and an order that never catches up."""
    shots = [shot_of(0, random_frame(100 + number, VIEWS, seed=number)) for number in range(4)]
    orders = BackgroundOrders()
    first = orders.order(shots[0], False)
    gated.gate.clear()
    gated.begun.clear()
    assert orders.order(shots[1], False) is first
    assert gated.begun.wait(10)
    assert orders.order(shots[2], False) is first
    assert orders.order(shots[3], False) is first
    gated.gate.set()
    eventually(lambda: fits(orders.order(shots[3], False), shots[3]))
    assert_orders(orders.order(shots[3], False), shots[3])
    assert [id(frame) for frame in gated.sorted] == [id(shots[number].frame) for number in (0, 1, 3)]
    orders.release()


def test_nothing_is_sorted_while_nothing_moves(gated: type[GatedSorter]) -> None:
    """Catches a thread that sorts the same request without end."""
    orders, request = BackgroundOrders(), shot_of()
    order = orders.order(request, True)
    for _ in range(10):
        assert orders.order(request, False) is order
        time.sleep(0.002)
    assert len(gated.sorted) == 1
    orders.release()


@pytest.mark.parametrize("asked", [False, True])
def test_release_ends_the_thread(asked: bool) -> None:
    """Catches a thread that stays with every change of the renderer."""
    before = set(threading.enumerate())
    orders = BackgroundOrders()
    assert len(set(threading.enumerate()) - before) == 1
    if asked:
        orders.order(shot_of(), False)
    orders.release()
    assert set(threading.enumerate()) <= before


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("wait", [True, False])
@pytest.mark.parametrize("earlier", [False, True])
def test_an_error_of_the_thread_reaches_the_caller(earlier: bool, wait: bool) -> None:
    """Catches a viewer that waits for ever, or shows an old order for ever, after the thread has died."""
    orders, request = BackgroundOrders(), shot_of()
    if earlier:
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
    ("wanted", "driver", "name"),
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
def test_the_renderer_suits_the_driver(
    wanted: RendererName | Literal["auto"], driver: str | None, name: RendererName
) -> None:
    """Catches a GPU left idle, a GL drawn by the CPU where our kernel is faster, and a wish that is not granted."""
    chosen = choose_renderer(wanted, driver)
    assert chosen.name == name
    assert chosen.reason
    if wanted == "auto" and driver is not None:
        assert driver in chosen.reason


@pytest.mark.parametrize("wanted", [name for name in RENDERERS if name != "cpu"])
def test_a_renderer_without_gl_is_refused(wanted: RendererName) -> None:
    """Catches a wish that is silently replaced, or that fails deep inside GL."""
    with pytest.raises(UserError, match=f"--renderer: expected cpu.*got {wanted}; add --renderer cpu"):
        choose_renderer(wanted, None)
