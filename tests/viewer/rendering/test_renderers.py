"""All renderers of the viewer compared with the torch reference."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from OpenGL import GL

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.reconstruction.training.memory import resident_bytes
from fourd.rendering import render_points
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference
from fourd.rendering.ops.play.near_fade import fade_near
from fourd.scene import BakedFrame, SceneManifest
from fourd.scene.shade import shade_reference
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import driver_info
from fourd.viewer.gl.frame_textures import Precision
from fourd.viewer.gl.passes import release_framebuffer
from fourd.viewer.rendering.renderers import RENDERERS, Renderer, RendererName, make_renderer
from fourd.viewer.shader_files import read_shader
from tests.baking.scenes import NEAR_IN_BALL, manifest, random_frame, ring
from tests.viewer.gl import contexts, render
from tests.viewer.scenes import shell_frame

EXACT: tuple[RendererName, ...] = ("peel", "dual", "cpu")
LAYERS = 12
BACKGROUND = (0.2, 0.4, 0.8)  # Bytes represent this colour exactly, so that all renderers agree.


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    yield from contexts()


@pytest.fixture
def make(context: moderngl.Context) -> Iterator[object]:
    """A function that creates renderers. All created renderers are released after the test."""
    made: list[Renderer] = []

    def make_one(name: RendererName, precision: Precision = "float16") -> Renderer:
        made.append(make_renderer(name, context, precision))
        return made[-1]

    yield make_one
    for renderer in made:
        renderer.release()


def reference(request: RenderRequest, layers: int | None = None) -> NDArray[np.float32]:
    """The image (H, W, 3) of the torch reference, composited over the background colour."""
    frame, settings = request.frame, request.settings
    colours = shade_reference(frame, request.camera, request.manifest)
    density = fade_near(frame.xyz, frame.density, request.camera, request.manifest.near)
    arrays = (frame.xyz, colours, frame.radius.astype(np.float32), density)
    rendered = render_points(
        *(torch.from_numpy(array.copy()) for array in arrays),
        request.camera,
        layers=layers or settings.layers,
        near=request.manifest.near,
        background=torch.tensor(settings.background),
        backend="reference",
    )
    return filter_pixels_reference(rendered.features.clamp(0, 1).numpy(), request.manifest.pixel_filter)


def require_parity(name: str, got: NDArray[np.float32], truth: NDArray[np.float32]) -> None:
    """Assert that an image matches the reference. The sorted renderer must reach a PSNR of 40 dB, and the other
    renderers must meet error bounds."""
    difference = np.abs(got[..., :3] - truth)
    if name == "sorted":
        assert -10 * np.log10(np.square(difference).mean() + 1e-12) >= 40
        return
    assert difference.mean() <= 1e-3
    assert (difference.max(axis=2) > 0.02).mean() <= 1e-3


def small_camera(index: int, width: int = 96, height: int = 64) -> Camera:
    return ring(5, size=64)[index].crop(-(width - 64) // 2, -(height - 64) // 2, width, height)


def make_request(
    frame: BakedFrame, camera: Camera, settings: DisplaySettings | None = None, views: int = 6
) -> RenderRequest:
    return RenderRequest(frame, camera, manifest(views), settings or DisplaySettings(LAYERS, BACKGROUND))


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("index", range(3))
def test_shell_matches_reference(name: RendererName, index: int, make, context: moderngl.Context) -> None:
    """Catches a flipped image, a wrong falloff, swapped source views or SH terms, and a missing background."""
    request = make_request(shell_frame(3000, seed=index), small_camera(index))
    require_parity(name, render(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", ["sorted", "peel", "dual"])
@pytest.mark.parametrize("size", [(97, 63), (64, 48), (3, 2), (1, 1)])
@pytest.mark.parametrize("has_derivatives", [True, False])
def test_the_filter_is_applied_to_the_unfiltered_picture(
    name: RendererName,
    size: tuple[int, int],
    has_derivatives: bool,
    make,
    context: moderngl.Context,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches swapped neighbours in quads of fragments, a wrong border, and pixels outside the filtered region."""
    if not has_derivatives:
        monkeypatch.setattr(
            "fourd.viewer.gl.shaders.read_shader",
            lambda file: read_shader(file).replace("GL_ARB_derivative_control", "GL_ARB_none"),
        )
    renderer = make(name)
    for index, distance in ((0, 0.0), (1, 4.0)):
        camera = small_camera(index, *size)
        far = replace(camera, translation=camera.translation + np.array([0.1, -0.1, distance]))
        request = make_request(random_frame(3000, 6, seed=index), far)
        plain = render(renderer, replace(request, manifest=replace(request.manifest, pixel_filter=0.0)), context)
        expected = filter_pixels_reference(plain[..., :3].copy(), request.manifest.pixel_filter)
        np.testing.assert_allclose(render(renderer, request, context)[..., :3], expected, atol=1e-6)


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("layers", [1, 2, 5, 12, 15])
def test_only_the_k_nearest_layers_are_composited(
    name: RendererName, layers: int, make, context: moderngl.Context
) -> None:
    """Catches far layers among the K nearest depth layers, an additional layer for odd K, and depth peeling that stops
    too early."""
    frame = random_frame(3000, 6, seed=layers)
    thin = replace(frame, density=(frame.density * np.float16(0.3)).astype(np.float16))
    request = make_request(thin, small_camera(1), DisplaySettings(layers, (0.8, 0.2, 0.4)))
    require_parity(name, render(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", EXACT)
def test_depth_ties_are_ordered_by_index(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches points of equal depth that are missing, drawn twice or drawn in the wrong order."""
    camera = Camera(np.array([[60.0, 0, 48], [0, 60, 32], [0, 0, 1]]), np.eye(3), np.array([0.0, 0, 3]), 96, 64)
    frame = random_frame(2000, 6, seed=3)
    flat = frame.xyz.copy()
    flat[:, 2] = np.round(flat[:, 2] * 2) / 2
    request = make_request(replace(frame, xyz=flat), camera)
    require_parity(name, render(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
def test_large_points_near_the_camera(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches sprites whose size is clamped to the driver's maximum, missing points with centres outside the image, and
    visible points behind the camera."""
    frame = shell_frame(1500, seed=8)
    camera = small_camera(2)
    along = np.linspace(-0.3, 0.9, 40)[:, None] * camera.forward
    noise = np.random.default_rng(5).normal(0, 0.15, (40, 3))
    xyz = np.concatenate([frame.xyz, (camera.centre + along + noise).astype(np.float32)])[-1500:]
    request = make_request(replace(frame, xyz=np.ascontiguousarray(xyz)), camera)
    depth = request.frame.xyz.astype(np.float64) @ camera.forward + camera.translation[2]
    assert (depth < 0).any()
    assert (camera.intrinsics[1, 1] * 0.08 / depth.clip(0.01) > 128).any(), "no point exceeds the maximum sprite size"
    # The sorted renderer composites all layers, so its reference must do the same.
    truth = reference(request, layers=64 if name == "sorted" else LAYERS)
    require_parity(name, render(make(name), request, context), truth)


@pytest.mark.parametrize("name", RENDERERS)
def test_points_fade_at_the_near_plane(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches a renderer that cuts points off at the near plane."""
    request = make_request(shell_frame(2000, seed=5), small_camera(3))
    request = replace(request, manifest=replace(request.manifest, near=NEAR_IN_BALL))
    require_parity(name, render(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", ["sorted", "peel", "dual"])
def test_discs_with_centres_outside_the_image(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches discs that disappear if their centre is outside the image."""
    request = make_request(shell_frame(400, seed=9), small_camera(0).crop(60, 20, 24, 24))
    require_parity(name, render(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("points", [0, 1])
def test_frames_of_zero_or_one_points(name: RendererName, points: int, make, context: moderngl.Context) -> None:
    """Catches an error from an empty draw call, and an empty frame whose image shows the previous content."""
    renderer = make(name)
    request = make_request(random_frame(points, 6, seed=2), small_camera(0))
    require_parity(name, render(renderer, request, context), reference(request))
    render(renderer, make_request(shell_frame(500, seed=1), small_camera(0)), context)
    require_parity(name, render(renderer, request, context), reference(request))


@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("name", RENDERERS)
def test_points_with_invalid_values_are_culled(name: RendererName, make, context) -> None:
    """Catches NaN and infinity of single points that spread over the image."""
    frame = shell_frame(1000, seed=4)
    xyz, radius = frame.xyz.copy(), frame.radius.copy()
    xyz[::7] = np.nan
    xyz[1::7, 1] = np.inf
    radius[2::7] = 0
    request = make_request(replace(frame, xyz=xyz, radius=radius), small_camera(1))
    require_parity(name, render(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
def test_scenes_without_source_views(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches a division by zero in a scene without source views."""
    frame = shell_frame(800, seed=6)
    bare = replace(frame, blend_weights=frame.blend_weights[:, :0], rgb=frame.rgb[:, :0])
    without_views = replace(
        manifest(2), source_names=(), source_cameras=(), sh_base=0.5, other_names=(), other_cameras=()
    )
    request = RenderRequest(bare, small_camera(0), without_views, DisplaySettings(LAYERS))
    require_parity(name, render(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
def test_a_renderer_draws_different_frames_and_sizes(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches textures, depth orders and colours of the previous image that appear in the next image."""
    renderer = make(name)
    for seed, size in ((1, (96, 64)), (2, (40, 80)), (1, (96, 64)), (3, (130, 50))):
        request = make_request(shell_frame(600 + 700 * seed, seed), small_camera(seed, *size))
        require_parity(name, render(renderer, request, context), reference(request))


@pytest.mark.parametrize("name", ["peel", "dual"])
def test_float32_is_more_exact_than_float16(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches a parameter ``precision`` that has no effect."""
    request = make_request(shell_frame(2000, seed=12), small_camera(0))
    truth = reference(request)
    half, single = (
        np.abs(render(make(name, precision), request, context)[..., :3] - truth).mean()
        for precision in ("float16", "float32")
    )
    assert single < half / 4


def test_background_order_becomes_exact_when_the_camera_stops(make, context: moderngl.Context) -> None:
    """Catches a depth order that remains outdated after the camera has stopped."""
    renderer = make("sorted")
    frame = shell_frame(2000, seed=7)
    for index in range(4):
        request = make_request(frame, small_camera(index))
        canvas = Canvas(context)
        renderer.draw(request, canvas)
        for _ in range(1000):
            if renderer.stale_images == 0:
                break
            renderer.draw(request, canvas)
        canvas.release()
        assert renderer.stale_images == 0
        require_parity("sorted", render(renderer, request, context), reference(request))


def test_arrays_above_the_texture_limit_raise(context: moderngl.Context) -> None:
    """Catches a driver error or an incomplete scene if the arrays of a frame exceed the largest texture."""
    from fourd.viewer.gl.frame_textures import ArrayTexture
    from fourd.viewer.gl.shaders import TEXELS_PER_ROW

    rows = driver_info(context)["GL_MAX_TEXTURE_SIZE"] + 1
    huge = np.broadcast_to(np.uint8(0), (rows * TEXELS_PER_ROW, 1))
    texture = ArrayTexture(context, 1, "f1")
    with pytest.raises(UserError, match=r"expected textures of 4096 x \d+ texels .* add --renderer cpu"):
        texture.reserve(huge.shape[0])


@pytest.mark.parametrize("name", RENDERERS)
def test_renderers_release_their_gl_objects(name: RendererName, context: moderngl.Context) -> None:
    """Catches textures, buffers, programs and framebuffers that remain after a renderer is released."""
    request = make_request(shell_frame(300, seed=1), small_camera(0))

    def open_and_close() -> None:
        renderer = make_renderer(name, context)
        render(renderer, request, context)
        renderer.release()
        gc.collect()

    open_and_close()
    before = count_gl_objects(context)
    for _ in range(5):
        open_and_close()
    after = count_gl_objects(context)
    assert after.pop("glIsProgram") <= before.pop("glIsProgram") + 1, "the program in use is deleted later"
    assert after == before


def count_gl_objects(context: moderngl.Context) -> dict[str, int]:
    """Number of existing OpenGL objects of each kind."""
    newest = context.texture((1, 1), 4)
    framebuffer = context.framebuffer([newest])
    last = 64 + max(newest.glo, framebuffer.glo)
    release_framebuffer(context, framebuffer)
    newest.release()
    queries = (
        GL.glIsTexture,
        GL.glIsBuffer,
        GL.glIsFramebuffer,
        GL.glIsRenderbuffer,
        GL.glIsVertexArray,
        GL.glIsProgram,
        GL.glIsQuery,
    )
    return {query.__name__: sum(bool(query(name)) for name in range(1, last)) for query in queries}


def test_manifest_constants_reach_the_shader(make, context: moderngl.Context) -> None:
    """Catches shaders with hard-coded values of sh_range, sh_base, near, neighbours and view weights."""
    changed: SceneManifest = replace(manifest(6), sh_range=0.4, sh_base=0.1, near=2.6, neighbours=2, fade_views=False)
    request = RenderRequest(shell_frame(2000, seed=3), small_camera(1), changed, DisplaySettings(LAYERS))
    for name in RENDERERS:
        # The sorted renderer composites all layers, and behind points that fade, there are more than LAYERS.
        truth = reference(request, layers=64 if name == "sorted" else LAYERS)
        require_parity(name, render(make(name), request, context), truth)


@pytest.mark.slow
@pytest.mark.parametrize("name", RENDERERS)
def test_a_thousand_images_leak_nothing(name: RendererName, context: moderngl.Context) -> None:
    """Catches OpenGL objects and memory whose number or size grows with the number of drawn images."""
    renderer, canvas = make_renderer(name, context), Canvas(context)
    frames = [shell_frame(200 + 10 * number, seed=number) for number in range(5)]

    def play(count: int) -> None:
        for number in range(count):
            camera = small_camera(number % 5, 40 + 8 * (number % 3), 40)
            renderer.draw(make_request(frames[number % len(frames)], camera), canvas, wait=number % 2 == 0)

    play(30)
    before, memory = count_gl_objects(context), resident_bytes()
    play(1000)
    assert count_gl_objects(context) == before
    assert resident_bytes() - memory < 32 << 20
    renderer.release()
    canvas.release()
