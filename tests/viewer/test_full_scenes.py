"""Full scenes in the viewer: a ball in a large room, in all renderers and during playback."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.cli.main import main
from fourd.scene import SceneWriter, combine_frames, open_scene
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.depth_order import ExactOrders
from fourd.viewer.gl.discs import Discs
from fourd.viewer.gl.frame_textures import ArrayTexture, FrameTextures
from fourd.viewer.playback.sources import open_frame_source
from fourd.viewer.rendering.offscreen import OffscreenRenderer
from fourd.viewer.rendering.renderers import RENDERERS, RendererName, make_renderer
from fourd.viewer.session import LoadedScene, Session
from tests.baking.scenes import full_manifest, manifest, random_frame, room_frame, write_full_scene, write_scene
from tests.viewer.gl import contexts, render
from tests.viewer.rendering.test_renderers import reference, require_parity
from tests.viewer.scenes import shell_frame

HALF = 20.0
SIZE = (64, 48)
MAX_LAYERS = 64


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    yield from contexts()


def camera_at(eye: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    intrinsics = np.array([[60.0, 0, 48], [0, 60, 32], [0, 0, 1]])
    return look_at(np.array(eye, float), np.array(at, float), np.array([0.0, 0, 1]), intrinsics, 96, 64)


CAMERAS = {
    "beside the ball": camera_at((2.0, 1.5, 0.5)),
    "in a corner": camera_at((0.9 * HALF, 0.9 * HALF, 0.8 * HALF)),
    "at a wall": camera_at((0.98 * HALF, 0, 0), (HALF, 0.4 * HALF, -0.2 * HALF)),
    "outside": camera_at((3 * HALF, 2 * HALF, HALF)),
    "far outside": camera_at((300.0, 200, 50)),
}


@cache
def request_from(camera: str) -> RenderRequest:
    """A render request for a ball in a room. The points of the walls are tens of times as far away and tens of times as
    large as the points of the ball."""
    room = room_frame(1200, 6, seed=2, half=HALF)
    shadow = np.where(room.xyz[:, 2] < 0, 70, 128).astype(np.uint8)
    settings = DisplaySettings(MAX_LAYERS, (0.2, 0.4, 0.8))
    return RenderRequest(
        combine_frames(shell_frame(800, seed=1), room, shadow), CAMERAS[camera], full_manifest(), settings
    )


@cache
def truth(camera: str, layers: int) -> NDArray[np.float32]:
    return reference(request_from(camera), layers)


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("camera", CAMERAS)
def test_ball_in_a_room_matches_reference(name: RendererName, camera: str, context: moderngl.Context) -> None:
    """Catches clip planes, depth ranges or point sizes that suit only the ball. The walls would then be clipped, hide
    the ball, or have holes.
    """
    # The sorted renderer composites all layers, and views along a wall have more than 12 layers.
    layers = MAX_LAYERS if name == "sorted" else 12
    request = request_from(camera)
    # The test uses float32, because rounding of 12 layers per pixel to float16 would hide errors.
    renderer = make_renderer(name, context, "float32")
    picture = render(renderer, replace(request, settings=replace(request.settings, layers=layers)), context)
    renderer.release()
    if name == "sorted":
        require_parity(name, picture, truth(camera, layers))
    else:
        # The tolerance covers rounding to bytes, layers skipped below a transmittance of 0.001, and float rounding.
        tolerance = {"cpu": 1 / 255, "dual": 1e-3, "peel": 1e-4}[name]
        assert np.abs(picture[..., :3] - truth(camera, layers)).max() < tolerance


@pytest.mark.parametrize("name", ["peel", "dual"])
def test_float16_is_within_a_byte_step(name: RendererName, context: moderngl.Context) -> None:
    """Catches float16 sums in which the far depth layers are lost by rounding."""
    request = request_from("in a corner")
    renderer = make_renderer(name, context)
    picture = render(renderer, replace(request, settings=replace(request.settings, layers=12)), context)
    renderer.release()
    assert np.abs(picture[..., :3] - truth("in a corner", 12)).max() < 1 / 255


def test_large_far_points_are_drawn_as_sprites(context: moderngl.Context) -> None:
    """Catches large but distant points that are drawn as quads instead of sprites. Quads have four times as many
    vertices."""
    room, ball = room_frame(2500, 6, seed=2, half=200.0), shell_frame(1500, seed=1)
    camera = replace(CAMERAS["beside the ball"], intrinsics=np.array([[300.0, 0, 48], [0, 300, 32], [0, 0, 1]]))
    near = replace(camera, translation=camera.translation - [0, 0, 2.0])
    canvas = Canvas(context)
    canvas.framebuffer(96, 64).use()
    textures = FrameTextures(context, "float16")
    discs = Discs(context, {"blend": "sorted.frag"})
    for view, uses_sprites in ((camera, True), (near, False)):
        request = RenderRequest(combine_frames(ball, room), view, full_manifest(), DisplaySettings())
        textures.load(request.frame)
        discs.project(textures, ExactOrders().order(request, True).points, request)
        assert discs.uses_sprites == uses_sprites
    for item in (discs, textures, canvas):
        item.release()


def test_the_background_is_uploaded_once(context: moderngl.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a background that is uploaded again with every frame, or that is drawn with the shadow or the storage of
    another frame."""
    room = room_frame(3000, 6, seed=2, half=HALF)
    shadow = np.where(room.xyz[:, 2] < 0, 70, 128).astype(np.uint8)
    counts = (700, 760, 300, 750, 700, 700, 760, 300, 2000)
    shadows = (None, None, None, None, shadow, shadow, None, None, None)
    frames = [
        combine_frames(shell_frame(count, seed=count), room, cast) for count, cast in zip(counts, shadows, strict=True)
    ]
    uploads: list[int] = []
    write = ArrayTexture.write

    def count_bytes(texture: ArrayTexture, array: NDArray[np.generic], first: int = 0) -> None:
        uploads.append(array.nbytes)
        write(texture, array, first)

    monkeypatch.setattr(ArrayTexture, "write", count_bytes)
    request = replace(request_from("beside the ball"), settings=DisplaySettings(12))
    renderer = make_renderer("peel", context)
    for number, frame in enumerate(frames):
        uploads.clear()
        picture = render(renderer, replace(request, frame=frame), context)
        # The renderer keeps two sets of textures, and each set contains the background. The colours of the background
        # are uploaded again for a frame with a shadow, and for the next frame in the same textures.
        background_bytes = room.nbytes if number in (0, 1, 8) else room.rgb.nbytes if number >= 4 else 0
        assert sum(uploads) == frame.nbytes - room.nbytes + background_bytes
        fresh = make_renderer("peel", context)
        np.testing.assert_array_equal(picture, render(fresh, replace(request, frame=frame), context))
        fresh.release()
    renderer.release()


def test_point_size_changes_the_background(context: moderngl.Context) -> None:
    """Catches background points whose radii do not change if the display settings scale the points."""
    request = request_from("in a corner")
    settings = DisplaySettings(12, point_scale=0.5, density_scale=0.8)
    renderer, fresh = make_renderer("peel", context), make_renderer("peel", context)
    scaled = replace(request, frame=settings.scale_points(request.frame), settings=settings)
    expected = render(fresh, scaled, context)
    render(renderer, request, context)
    for _ in range(3):
        again = replace(scaled, frame=settings.scale_points(request.frame))
        np.testing.assert_array_equal(render(renderer, again, context), expected)
    renderer.release()
    fresh.release()


def test_a_session_plays_a_full_scene(tmp_path: Path) -> None:
    """Catches frames that play without their background, with the shadow of another frame, or in the wrong order."""
    dynamic, room, _ = write_full_scene(tmp_path / "full.4dv", frames=4, points=300, background_points=2500)
    session = Session(DisplaySettings())
    session.open(tmp_path / "full.4dv")
    loaded = session.take_opened(wait=True)
    assert loaded is not None, session.message
    session.show(loaded, loaded.initial_pose(SIZE))
    with OffscreenRenderer("cpu") as offscreen, open_scene(tmp_path / "full.4dv") as scene:
        for index in range(4):
            request = session.render_request(SIZE, wait=True)
            assert request is not None
            assert session.playback.frame == index
            assert request.frame.point_count == dynamic[index].point_count + room.point_count
            expected = scene.render(request.camera, index).to_uint8()
            assert np.abs(offscreen.render(request).astype(int) - expected).max() <= 1
            session.advance(1 / loaded.manifest.fps + 1e-6)
        assert session.playback.frame == 0
    session.close()


def test_initial_pose_ignores_the_background(tmp_path: Path) -> None:
    """Catches an initial pose that is chosen to show the whole room instead of the foreground."""
    write_full_scene(tmp_path / "full.4dv")
    write_scene(tmp_path / "object.4dv")
    poses = []
    for name in ("full.4dv", "object.4dv"):
        loaded = LoadedScene(tmp_path / name, open_frame_source(tmp_path / name))
        poses.append(loaded.initial_pose(SIZE))
        loaded.close()
    assert poses[0].distance == poses[1].distance
    np.testing.assert_array_equal(poses[0].eye, poses[1].eye)
    bare = replace(full_manifest(2, 1), source_names=(), source_cameras=(), other_names=(), other_cameras=())
    with SceneWriter(tmp_path / "bare.4dv", bare) as writer:
        writer.add_background(room_frame(100, 0, seed=1))
        writer.add_frame(0, random_frame(100, 0, seed=1))
    loaded = LoadedScene(tmp_path / "bare.4dv", open_frame_source(tmp_path / "bare.4dv"))
    assert loaded.initial_pose(SIZE).distance < 5
    loaded.close()


def test_a_scene_of_only_background_is_shown(tmp_path: Path) -> None:
    """Catches a scene that is rejected because its frames have no points, although its background has points."""
    with SceneWriter(tmp_path / "background.4dv", full_manifest(6, 1)) as writer:
        writer.add_background(room_frame(2500, 6, seed=1))
        writer.add_frame(0, random_frame(0, 6, seed=1))
    words = ["view", tmp_path / "background.4dv", "--screenshot", tmp_path / "image.png", "--renderer", "cpu"]
    assert main([str(word) for word in words]) == 0


@pytest.mark.parametrize("kind", ["object", "full"])
def test_info_describes_the_background(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a background that is counted in every frame or not at all, and a frame size that includes the
    background."""
    path = tmp_path / "scene.4dv"
    if kind == "full":
        write_full_scene(path, points=200, background_points=40_000)
    else:
        write_scene(path, points=200)
    assert main(["info", str(path)]) == 0
    lines = dict(line.split("  ", 1) for line in capsys.readouterr().out.splitlines() if "  " in line)
    fields = {name: value.strip() for name, value in lines.items()}
    assert fields["points"] == "200 to 202 per frame, 603 in total"
    if kind == "object":
        assert "background" not in fields
        assert fields["format"].startswith("version 1")
        return
    assert fields["format"].startswith("version 2")
    assert fields["kind"] == "object and background"
    assert fields["background"] == "40,000 points, stored once, with a shadow in every frame"
    shadow_and_points = 40_000 + random_frame(201, manifest().view_count, seed=0).nbytes
    frame_kb = float(fields["size"].split(", ")[1].removesuffix(" KB per frame"))
    assert frame_kb == pytest.approx(shadow_and_points / 1000, rel=0.1)


def test_commands_render_full_scenes(tmp_path: Path) -> None:
    """Catches a command that opens scenes without their background."""
    write_full_scene(tmp_path / "full.4dv", frames=2, points=300, background_points=4000)
    words = ["render", tmp_path / "full.4dv", "--out", tmp_path / "views", "--views", "held out"]
    assert main([str(word) for word in words]) == 0
    words = ["view", tmp_path / "full.4dv", "--screenshot", tmp_path / "image.png", "--camera", "held out"]
    assert main([str(word) for word in [*words, "--frame", 1, "--renderer", "cpu"]]) == 0
    from PIL import Image

    rendered = np.asarray(Image.open(tmp_path / "views" / "held out" / "000011.png"))
    viewed = np.asarray(Image.open(tmp_path / "image.png"))
    assert np.abs(rendered.astype(int) - viewed).max() <= 1
    with open_scene(tmp_path / "full.4dv") as scene:
        alpha = scene.render(scene.manifest.other_cameras[0], 1).alpha
    assert alpha.min() > 0.5
