"""Full scenes in the viewer: a ball in a large room, from everywhere, by every renderer, and while it plays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.baking import SceneWriter, combine_frames, open_scene
from fourd.cameras import Camera, look_at
from fourd.cli.main import main
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
from tests.viewer.gl import contexts, drawn
from tests.viewer.rendering.test_renderers import reference, require_parity
from tests.viewer.shells import solid

HALF = 20.0
SIZE = (64, 48)
MOST_LAYERS = 64


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    yield from contexts()


def standing(eye: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    intrinsics = np.array([[60.0, 0, 48], [0, 60, 32], [0, 0, 1]])
    return look_at(np.array(eye, float), np.array(at, float), np.array([0.0, 0, 1]), intrinsics, 96, 64)


PLACES = {
    "beside the ball": standing((2.0, 1.5, 0.5)),
    "in a corner": standing((0.9 * HALF, 0.9 * HALF, 0.8 * HALF)),
    "at a wall": standing((0.98 * HALF, 0, 0), (HALF, 0.4 * HALF, -0.2 * HALF)),
    "outside": standing((3 * HALF, 2 * HALF, HALF)),
    "far outside": standing((300.0, 200, 50)),
}


@cache
def shot_from(place: str) -> RenderRequest:
    """The ball before the walls, whose points are tens of times as far and as large."""
    room = room_frame(1200, 6, seed=2, half=HALF)
    shadow = np.where(room.xyz[:, 2] < 0, 70, 128).astype(np.uint8)
    settings = DisplaySettings(MOST_LAYERS, (0.2, 0.4, 0.8))
    return RenderRequest(combine_frames(solid(800, seed=1), room, shadow), PLACES[place], full_manifest(), settings)


@cache
def truth(place: str, layers: int) -> NDArray[np.float32]:
    return reference(shot_from(place), layers)


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("place", PLACES)
def test_a_ball_in_a_room(name: RendererName, place: str, context: moderngl.Context) -> None:
    """Catches planes, depths or sizes that fit the ball alone: walls cut off, before the ball, or full of holes."""
    # Sorted composites every layer; where one looks along a wall, there are more than 12.
    layers = MOST_LAYERS if name == "sorted" else 12
    request = shot_from(place)
    # In float16 each of 12 layers is rounded and no pixel is empty, which would hide what is looked for here.
    renderer = make_renderer(name, context, "float32")
    picture = drawn(renderer, replace(request, settings=replace(request.settings, layers=layers)), context)
    renderer.release()
    if name == "sorted":
        require_parity(name, picture, truth(place, layers))
    else:
        # Bytes; what is left out where less than 0.001 of the light comes from; rounding.
        most = {"cpu": 1 / 255, "dual": 1e-3, "peel": 1e-4}[name]
        assert np.abs(picture[..., :3] - truth(place, layers)).max() < most


@pytest.mark.parametrize("name", ["peel", "dual"])
def test_half_precision_is_enough_for_pictures_without_gaps(name: RendererName, context: moderngl.Context) -> None:
    """Catches sums in which the far layers are lost for the near ones."""
    request = shot_from("in a corner")
    renderer = make_renderer(name, context)
    picture = drawn(renderer, replace(request, settings=replace(request.settings, layers=12)), context)
    renderer.release()
    assert np.abs(picture[..., :3] - truth("in a corner", 12)).max() < 1 / 255


def test_large_points_far_away_do_not_slow_sprites_down(context: moderngl.Context) -> None:
    """Catches sprites given up, for four times the vertices, since a wall's point would be large where the ball is."""
    room, ball = room_frame(2500, 6, seed=2, half=200.0), solid(1500, seed=1)
    camera = replace(PLACES["beside the ball"], intrinsics=np.array([[300.0, 0, 48], [0, 300, 32], [0, 0, 1]]))
    near = replace(camera, translation=camera.translation - [0, 0, 2.0])
    canvas = Canvas(context)
    canvas.framebuffer(96, 64).use()
    uploaded = FrameTextures(context, "float16")
    discs = Discs(context, {"blend": "sorted.frag"})
    for seen, sprites in ((camera, True), (near, False)):
        request = RenderRequest(combine_frames(ball, room), seen, full_manifest(), DisplaySettings())
        uploaded.load(request.frame)
        discs.project(uploaded, ExactOrders().order(request, True).points, request)
        assert discs.uses_sprites == sprites
    for held in (discs, uploaded, canvas):
        held.release()


def test_the_background_is_uploaded_once(context: moderngl.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a room sent to the GPU with every frame, and one left in the shadow or at the place of another frame."""
    room = room_frame(3000, 6, seed=2, half=HALF)
    shadow = np.where(room.xyz[:, 2] < 0, 70, 128).astype(np.uint8)
    counts = (700, 760, 300, 750, 700, 700, 760, 300, 2000)
    casts = (None, None, None, None, shadow, shadow, None, None, None)
    frames = [combine_frames(solid(count, seed=count), room, cast) for count, cast in zip(counts, casts, strict=True)]
    sent: list[int] = []
    write = ArrayTexture.write

    def counted(texture: ArrayTexture, array: NDArray[np.generic], first: int = 0) -> None:
        sent.append(array.nbytes)
        write(texture, array, first)

    monkeypatch.setattr(ArrayTexture, "write", counted)
    request = replace(shot_from("beside the ball"), settings=DisplaySettings(12))
    renderer = make_renderer("peel", context)
    for number, frame in enumerate(frames):
        sent.clear()
        picture = drawn(renderer, replace(request, frame=frame), context)
        # Two frames are held at a time, each with the room; colours come again in a shadow and after one.
        again = room.nbytes if number in (0, 1, 8) else room.rgb.nbytes if number >= 4 else 0
        assert sum(sent) == frame.nbytes - room.nbytes + again
        alone = make_renderer("peel", context)
        np.testing.assert_array_equal(picture, drawn(alone, replace(request, frame=frame), context))
        alone.release()
    renderer.release()


def test_a_session_plays_a_full_scene(tmp_path: Path) -> None:
    """Catches frames without their background, with that of another frame's shadow, or in each other's place."""
    moving, room, _ = write_full_scene(tmp_path / "full.4dv", frames=4, points=300, background_points=2500)
    session = Session(DisplaySettings())
    session.open(tmp_path / "full.4dv")
    opened = session.take_opened(wait=True)
    assert opened is not None, session.message
    session.show(opened, opened.initial_pose(SIZE))
    with OffscreenRenderer("cpu") as offscreen, open_scene(tmp_path / "full.4dv") as scene:
        for index in range(4):
            request = session.render_request(SIZE, wait=True)
            assert request is not None
            assert session.playback.frame == index
            assert request.frame.point_count == moving[index].point_count + room.point_count
            expected = scene.render(request.camera, index).to_uint8()
            assert np.abs(offscreen.render(request).astype(int) - expected).max() <= 1
            session.advance(1 / opened.manifest.fps + 1e-6)
        assert session.playback.frame == 0
    session.close()


def test_where_one_stands_does_not_depend_on_the_background(tmp_path: Path) -> None:
    """Catches a first view, or a pivot, that stands back from the whole room."""
    write_full_scene(tmp_path / "full.4dv")
    write_scene(tmp_path / "object.4dv")
    starts = []
    for name in ("full.4dv", "object.4dv"):
        opened = LoadedScene(tmp_path / name, open_frame_source(tmp_path / name))
        starts.append(opened.initial_pose(SIZE))
        opened.close()
    assert starts[0].distance == starts[1].distance
    np.testing.assert_array_equal(starts[0].eye, starts[1].eye)
    bare = replace(full_manifest(2, 1), source_names=(), source_cameras=(), other_names=(), other_cameras=())
    with SceneWriter(tmp_path / "bare.4dv", bare) as writer:
        writer.add_background(room_frame(100, 0, seed=1))
        writer.add_frame(0, random_frame(100, 0, seed=1))
    opened = LoadedScene(tmp_path / "bare.4dv", open_frame_source(tmp_path / "bare.4dv"))
    assert opened.initial_pose(SIZE).distance < 5
    opened.close()


def test_an_empty_stage_is_shown(tmp_path: Path) -> None:
    """Catches a scene refused for having no points, where its background has some."""
    with SceneWriter(tmp_path / "stage.4dv", full_manifest(6, 1)) as writer:
        writer.add_background(room_frame(2500, 6, seed=1))
        writer.add_frame(0, random_frame(0, 6, seed=1))
    words = ["view", tmp_path / "stage.4dv", "--screenshot", tmp_path / "seen.png", "--renderer", "cpu"]
    assert main([str(word) for word in words]) == 0


@pytest.mark.parametrize("kind", ["object", "full"])
def test_info_tells_of_the_background(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a background counted with every frame, or not at all, and a size a frame that holds it."""
    path = tmp_path / "scene.4dv"
    if kind == "full":
        write_full_scene(path, points=200, background_points=40_000)
    else:
        write_scene(path, points=200)
    assert main(["info", str(path)]) == 0
    lines = dict(line.split("  ", 1) for line in capsys.readouterr().out.splitlines() if "  " in line)
    told = {name: value.strip() for name, value in lines.items()}
    assert told["points"] == "200 to 202 a frame, 603 in all"
    if kind == "object":
        assert "background" not in told
        assert told["format"].startswith("version 1")
        return
    assert told["format"].startswith("version 2")
    assert told["kind"] == "object and background"
    assert told["background"] == "40,000 points, stored once, with a shadow in every frame"
    shadow_and_points = 40_000 + random_frame(201, manifest().view_count, seed=0).nbytes
    a_frame = float(told["size"].split(", ")[1].removesuffix(" KB a frame"))
    assert a_frame == pytest.approx(shadow_and_points / 1000, rel=0.1)


def test_commands_render_full_scenes(tmp_path: Path) -> None:
    """Catches a command with a way of its own to open scenes, which would show the points on black."""
    write_full_scene(tmp_path / "full.4dv", frames=2, points=300, background_points=4000)
    words = ["render", tmp_path / "full.4dv", "--out", tmp_path / "views", "--views", "held out"]
    assert main([str(word) for word in words]) == 0
    words = ["view", tmp_path / "full.4dv", "--screenshot", tmp_path / "seen.png", "--camera", "held out"]
    assert main([str(word) for word in [*words, "--frame", 1, "--renderer", "cpu"]]) == 0
    from PIL import Image

    rendered = np.asarray(Image.open(tmp_path / "views" / "held out" / "000011.png"))
    seen = np.asarray(Image.open(tmp_path / "seen.png"))
    assert np.abs(rendered.astype(int) - seen).max() <= 1
    with open_scene(tmp_path / "full.4dv") as scene:
        alpha = scene.render(scene.manifest.other_cameras[0], 1).alpha
    assert alpha.min() > 0.5
