"""Every renderer against the reference, at the same camera."""

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

from fourd.baking import BakedFrame, SceneManifest
from fourd.baking.shade import shade_reference
from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.raster import render_points
from fourd.training.memory import resident_bytes
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import driver_info
from fourd.viewer.gl.frame_textures import Precision
from fourd.viewer.gl.passes import release_framebuffer
from fourd.viewer.rendering.renderers import RENDERERS, Renderer, RendererName, make_renderer
from tests.baking.scenes import manifest, random_frame, ring
from tests.viewer.gl import contexts, drawn
from tests.viewer.shells import solid

EXACT: tuple[RendererName, ...] = ("peel", "dual", "cpu")
LAYERS = 12
BACKGROUND = (0.2, 0.4, 0.8)  # whole bytes: the same for every renderer


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    yield from contexts()


@pytest.fixture
def make(context: moderngl.Context) -> Iterator[object]:
    """Makes renderers, and releases them."""
    made: list[Renderer] = []

    def make_one(name: RendererName, precision: Precision = "float16") -> Renderer:
        made.append(make_renderer(name, context, precision))
        return made[-1]

    yield make_one
    for renderer in made:
        renderer.release()


def reference(request: RenderRequest, layers: int | None = None) -> NDArray[np.float32]:
    """(H, W, 3) by the torch reference, over the background."""
    frame, settings = request.frame, request.settings
    colours = shade_reference(frame, request.camera, request.manifest)
    arrays = (frame.xyz, colours, frame.radius.astype(np.float32), frame.density.astype(np.float32))
    picture = render_points(
        *(torch.from_numpy(array.copy()) for array in arrays),
        request.camera,
        layers=layers or settings.layers,
        near=request.manifest.near,
        background=torch.tensor(settings.background),
        backend="reference",
    )
    return picture.features.clamp(0, 1).numpy()


def require_parity(name: str, got: NDArray[np.float32], truth: NDArray[np.float32]) -> None:
    """Exact renderers: the acceptance bounds. Sorted: 40 dB."""
    difference = np.abs(got[..., :3] - truth)
    if name == "sorted":
        assert -10 * np.log10(np.square(difference).mean() + 1e-12) >= 40
        return
    assert difference.mean() <= 1e-3
    assert (difference.max(axis=2) > 0.02).mean() <= 1e-3


def small_camera(index: int, width: int = 96, height: int = 64) -> Camera:
    return ring(5, size=64)[index].crop(-(width - 64) // 2, -(height - 64) // 2, width, height)


def shot_of(
    frame: BakedFrame, camera: Camera, settings: DisplaySettings | None = None, views: int = 6
) -> RenderRequest:
    return RenderRequest(frame, camera, manifest(views), settings or DisplaySettings(LAYERS, BACKGROUND))


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("index", range(3))
def test_a_solid_object(name: RendererName, index: int, make, context: moderngl.Context) -> None:
    """Catches any of: a flipped picture, a wrong falloff, views or harmonics mixed up, a background that is lost."""
    request = shot_of(solid(3000, seed=index), small_camera(index))
    require_parity(name, drawn(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("layers", [1, 2, 5, 12, 15])
def test_a_fog_of_more_layers_than_k(name: RendererName, layers: int, make, context: moderngl.Context) -> None:
    """Catches layers from the back among the K nearest, one too many for an odd K, and a peeling that ends early."""
    frame = random_frame(3000, 6, seed=layers)
    thin = replace(frame, density=(frame.density * np.float16(0.3)).astype(np.float16))
    request = shot_of(thin, small_camera(1), DisplaySettings(layers, (0.8, 0.2, 0.4)))
    require_parity(name, drawn(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", EXACT)
def test_ties_are_taken_by_index(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches points of one depth that are lost, drawn twice or in another order."""
    camera = Camera(np.array([[60.0, 0, 48], [0, 60, 32], [0, 0, 1]]), np.eye(3), np.array([0.0, 0, 3]), 96, 64)
    frame = random_frame(2000, 6, seed=3)
    flat = frame.xyz.copy()
    flat[:, 2] = np.round(flat[:, 2] * 2) / 2
    request = shot_of(replace(frame, xyz=flat), camera)
    require_parity(name, drawn(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
def test_big_near_points_and_points_across_the_near_plane(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches sprites cut to a driver's largest size, points lost whose centre is out of sight, and points behind."""
    frame = solid(1500, seed=8)
    camera = small_camera(2)
    ahead = np.linspace(-0.3, 0.9, 40)[:, None] * camera.forward
    beside = np.random.default_rng(5).normal(0, 0.15, (40, 3))
    xyz = np.concatenate([frame.xyz, (camera.centre + ahead + beside).astype(np.float32)])[-1500:]
    request = shot_of(replace(frame, xyz=np.ascontiguousarray(xyz)), camera)
    depth = request.frame.xyz.astype(np.float64) @ camera.forward + camera.translation[2]
    assert (depth < 0).any()
    assert (camera.intrinsics[1, 1] * 0.08 / depth.clip(0.01) > 128).any(), "no point is larger than a sprite may be"
    # Sorted composites every layer, so that is what it is held to.
    truth = reference(request, layers=64 if name == "sorted" else LAYERS)
    require_parity(name, drawn(make(name), request, context), truth)


@pytest.mark.parametrize("name", ["sorted", "peel", "dual"])
def test_centres_beside_the_picture(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches sprites that vanish as soon as their centre leaves the picture."""
    request = shot_of(solid(400, seed=9), small_camera(0).crop(60, 20, 24, 24))
    require_parity(name, drawn(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("points", [0, 1])
def test_hardly_any_points(name: RendererName, points: int, make, context: moderngl.Context) -> None:
    """Catches draw calls of nothing, and a picture that keeps what was there before."""
    renderer = make(name)
    request = shot_of(random_frame(points, 6, seed=2), small_camera(0))
    require_parity(name, drawn(renderer, request, context), reference(request))
    drawn(renderer, shot_of(solid(500, seed=1), small_camera(0)), context)
    require_parity(name, drawn(renderer, request, context), reference(request))


@pytest.mark.filterwarnings("ignore:invalid value encountered")
@pytest.mark.parametrize("name", RENDERERS)
def test_points_with_numbers_that_are_not_finite_are_left_out(name: RendererName, make, context) -> None:
    """Catches NaN that spreads over the picture, where a caller brings arrays of their own."""
    frame = solid(1000, seed=4)
    xyz, radius = frame.xyz.copy(), frame.radius.copy()
    xyz[::7] = np.nan
    xyz[1::7, 1] = np.inf
    radius[2::7] = 0
    request = shot_of(replace(frame, xyz=xyz, radius=radius), small_camera(1))
    require_parity(name, drawn(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
def test_scenes_without_source_views(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches a division by the number of views where there is none."""
    frame = solid(800, seed=6)
    bare = replace(frame, blend_weights=frame.blend_weights[:, :0], rgb=frame.rgb[:, :0])
    described = replace(manifest(2), source_names=(), source_cameras=(), sh_base=0.5, other_names=(), other_cameras=())
    request = RenderRequest(bare, small_camera(0), described, DisplaySettings(LAYERS))
    require_parity(name, drawn(make(name), request, context), reference(request))


@pytest.mark.parametrize("name", RENDERERS)
def test_one_renderer_draws_frames_and_sizes_in_turn(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches textures, orders and colours of the picture before that are kept for the next."""
    renderer = make(name)
    for seed, size in ((1, (96, 64)), (2, (40, 80)), (1, (96, 64)), (3, (130, 50))):
        request = shot_of(solid(600 + 700 * seed, seed), small_camera(seed, *size))
        require_parity(name, drawn(renderer, request, context), reference(request))


@pytest.mark.parametrize("name", ["peel", "dual"])
def test_float32_is_nearer_to_the_reference_than_float16(name: RendererName, make, context: moderngl.Context) -> None:
    """Catches a precision that is asked for and not used."""
    request = shot_of(solid(2000, seed=12), small_camera(0))
    truth = reference(request)
    half, single = (
        np.abs(drawn(make(name, precision), request, context)[..., :3] - truth).mean()
        for precision in ("float16", "float32")
    )
    assert single < half / 4


def test_an_order_from_the_background_is_exact_at_rest(make, context: moderngl.Context) -> None:
    """Catches an order that never catches up with the camera."""
    renderer = make("sorted")
    frame = solid(2000, seed=7)
    for index in range(4):
        request = shot_of(frame, small_camera(index))
        canvas = Canvas(context)
        renderer.draw(request, canvas)
        for _ in range(1000):
            if renderer.stale_images == 0:
                break
            renderer.draw(request, canvas)
        canvas.release()
        assert renderer.stale_images == 0
        require_parity("sorted", drawn(renderer, request, context), reference(request))


def test_a_scene_that_no_texture_holds_is_told(context: moderngl.Context) -> None:
    """Catches a driver's error, or half a scene, where the arrays are larger than its textures."""
    from fourd.viewer.gl.frame_textures import ArrayTexture
    from fourd.viewer.gl.shaders import TEXELS_PER_ROW

    rows = driver_info(context)["GL_MAX_TEXTURE_SIZE"] + 1
    huge = np.broadcast_to(np.uint8(0), (rows * TEXELS_PER_ROW, 1))
    texture = ArrayTexture(context, 1, "f1")
    with pytest.raises(UserError, match=r"expected textures of 4096 x \d+ texels .* add --renderer cpu"):
        texture.reserve(huge.shape[0])


@pytest.mark.parametrize("name", RENDERERS)
def test_renderers_give_back_their_gl_objects(name: RendererName, context: moderngl.Context) -> None:
    """Catches textures, buffers, programs and framebuffers that pile up with every scene that is opened."""
    request = shot_of(solid(300, seed=1), small_camera(0))

    def open_and_close() -> None:
        renderer = make_renderer(name, context)
        drawn(renderer, request, context)
        renderer.release()
        gc.collect()

    open_and_close()
    before = objects_in_use(context)
    for _ in range(5):
        open_and_close()
    after = objects_in_use(context)
    assert after.pop("glIsProgram") <= before.pop("glIsProgram") + 1, "the one in use goes when the next is used"
    assert after == before


def objects_in_use(context: moderngl.Context) -> dict[str, int]:
    """How many names of each kind stand for an object."""
    newest = context.texture((1, 1), 4)
    framebuffer = context.framebuffer([newest])
    last = 64 + max(newest.glo, framebuffer.glo)
    release_framebuffer(context, framebuffer)
    newest.release()
    asked = (
        GL.glIsTexture,
        GL.glIsBuffer,
        GL.glIsFramebuffer,
        GL.glIsRenderbuffer,
        GL.glIsVertexArray,
        GL.glIsProgram,
        GL.glIsQuery,
    )
    return {ask.__name__: sum(bool(ask(name)) for name in range(1, last)) for ask in asked}


def test_the_manifest_s_own_terms_reach_the_shader(make, context: moderngl.Context) -> None:
    """Catches constants of the shader where the manifest has others: range, base, near and neighbours."""
    described: SceneManifest = replace(manifest(6), sh_range=0.4, sh_base=0.1, near=2.6, neighbours=2)
    request = RenderRequest(solid(2000, seed=3), small_camera(1), described, DisplaySettings(LAYERS))
    truth = reference(request)
    for name in RENDERERS:
        require_parity(name, drawn(make(name), request, context), truth)


@pytest.mark.slow
@pytest.mark.parametrize("name", RENDERERS)
def test_a_thousand_frames_leave_no_objects_behind(name: RendererName, context: moderngl.Context) -> None:
    """Catches an object a picture that is never deleted, and sizes that grow with what was drawn before."""
    renderer, canvas = make_renderer(name, context), Canvas(context)
    frames = [solid(200 + 10 * number, seed=number) for number in range(5)]

    def play(pictures: int) -> None:
        for number in range(pictures):
            camera = small_camera(number % 5, 40 + 8 * (number % 3), 40)
            renderer.draw(shot_of(frames[number % len(frames)], camera), canvas, wait=number % 2 == 0)

    play(30)
    before, memory = objects_in_use(context), resident_bytes()
    play(1000)
    assert objects_in_use(context) == before
    assert resident_bytes() - memory < 32 << 20
    renderer.release()
    canvas.release()
