"""Virtual reality in the web player, with a headset that IWER (Immersive Web Emulation Runtime) emulates."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene import SceneReader
from fourd.scene.player import Player
from fourd.viewer.display import DEFAULT_BACKGROUND
from fourd.viewer.publish.site import SCENE_NAME
from tests.viewer.web.conftest import serving
from tests.viewer.web.npm import installed
from tests.viewer.web.page import PlayerPage

SIZE = 96
EMULATE = """
    window.headset = new IWER.XRDevice(IWER.metaQuest3, {stereoEnabled: true});
    headset.installRuntime({forceInstall: true});
"""
# After a session, IWER puts the canvas back into its parent element, but not into a shadow root.
WRAP_CANVAS = (
    "const box = document.createElement('div'); player.panel.canvas.before(box); box.append(player.panel.canvas);"
)
READ_EYES = """
    while (!player.vr || player.vr.images < 2 || stage.playback.sorter.isBusy || !stage.playback.order)
        await new Promise((resolve) => setTimeout(resolve, 5));
    return await new Promise((resolve) => {
        let images = 0;
        const {session, space, gl} = player.vr;
        const read = (time, frame) => {
            if (++images < 20 || !stage.store.isComplete(stage.clock.frame)) return session.requestAnimationFrame(read);
            const layer = session.renderState.baseLayer;
            resolve(frame.getViewerPose(space).views.map((view) => {
                const {x, y, width, height} = layer.getViewport(view);
                const bytes = new Uint8Array(4 * width * height);
                gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
                gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
                return {
                    size: [width, height],
                    eye: Array.from(view.transform.matrix),
                    projection: Array.from(view.projectionMatrix),
                    pixels: btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")),
                };
            }));
        };
        session.requestAnimationFrame(read);
    });
"""


@pytest.fixture
def enter(open_page: Callable[..., PlayerPage], object_site: Path) -> Iterator[Callable[[], PlayerPage]]:
    """A function that opens a page in a browser with an emulated headset, paused at frame 0, and enters VR."""
    script = (installed("iwer") / "build" / "iwer.min.js").read_text() + EMULATE

    with serving(object_site) as server:

        def open_one() -> PlayerPage:
            page = open_page("about:blank", (2 * SIZE, SIZE), is_new=True)
            page.page.context.add_init_script(script)
            page.page.goto(server.url)
            page.pause(0)
            page.run(WRAP_CANVAS)
            page.wait("!player.panel.vr.hidden")
            page.run("player.panel.vr.click();")
            page.wait("player.vr !== null && player.vr.images > 1")
            return page

        yield open_one


def eye_camera(eye: dict[str, Any], pose: dict[str, Any]) -> Camera:
    """The camera of an eye in the scene's world. The eye of the page's pose is at the origin of the headset's world."""
    width, height = eye["size"]
    up, rotation = np.array(pose["up"]), np.reshape(pose["rotation"], (3, 3))
    ahead = rotation[2] - (rotation[2] @ up) * up
    ahead /= np.linalg.norm(ahead)
    to_headset = np.stack([np.cross(ahead, up), up, -ahead])  # rows: right, up, backward
    start = np.array(pose["pivot"]) - pose["distance"] * rotation[2]
    unit = 1.5 / pose["distance"]  # metres per unit of the scene
    placed = np.reshape(eye["eye"], (4, 4)).T
    centre = start + to_headset.T @ placed[:3, 3] / unit
    axes = np.diag([1.0, -1, -1]) @ placed[:3, :3].T @ to_headset
    p = np.reshape(eye["projection"], (4, 4)).T
    intrinsics = np.array(
        [
            [p[0, 0] * width / 2, 0, (1 - p[0, 2]) * width / 2],
            [0, p[1, 1] * height / 2, (1 + p[1, 2]) * height / 2],
            [0, 0, 1],
        ]
    )
    return Camera(intrinsics, axes, -axes @ centre, width, height)


def psnr(got: NDArray[np.uint8], expected: NDArray[np.uint8]) -> float:
    error = np.square(got.astype(float) - expected).mean()
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


def test_the_button_is_hidden_without_a_headset(play: PlayerPage) -> None:
    """Catches a VR button that is visible although there is no headset."""
    assert play.run("return player.panel.vr.hidden;") is True


@pytest.mark.parametrize("head", [(0.0, 1.6, 0.0), (0.3, 1.7, -0.4)])
def test_both_eyes_show_the_image_of_the_cpu(
    head: tuple[float, float, float], enter: Callable[[], PlayerPage], object_site: Path
) -> None:
    """Catches exchanged eyes, a wrong scale or placement of the scene, and a view that does not follow the head."""
    page = enter()
    page.run("headset.position.set(...argument); if (argument[0]) headset.quaternion.set(0, 0.1305, 0, 0.9914);", head)
    eyes = page.run(READ_EYES)
    pose = page.run("return stage.pose;")
    reader = SceneReader(object_site / SCENE_NAME)
    frame, manifest = reader.read(0), reader.manifest
    reader.close()
    got, expected = [], []
    for eye in eyes:
        pixels = np.frombuffer(base64.b64decode(eye["pixels"]), np.uint8).reshape(eye["size"][1], eye["size"][0], 4)
        got.append(pixels[::-1, :, :3])
        expected.append(Player().draw(frame, eye_camera(eye, pose), manifest, background=DEFAULT_BACKGROUND)[..., :3])
    for own, other in ((0, 1), (1, 0)):
        assert expected[own].std() > 15
        # Both eyes share the source views and the weights of the head. The weights of the head differ slightly from the
        # weights of each eye.
        assert psnr(got[own], expected[own]) > max(35, psnr(got[own], expected[other]) + 10)
    assert page.problems == []


def test_the_controller_plays_turns_and_moves(enter: Callable[[], PlayerPage]) -> None:
    """Catches a trigger or a thumbstick without effect."""
    page = enter()
    start = page.run("return stage.pose;")
    page.run("headset.controllers.right.updateButtonValue('trigger', 1);")
    page.wait("stage.clock.isPlaying")
    page.run("headset.controllers.right.updateButtonValue('trigger', 0);")
    page.wait("stage.clock.frame > 0")
    page.run("headset.controllers.right.updateAxis('thumbstick', 'x-axis', 1);")
    page.wait(f"Math.abs(stage.pose.rotation[0] - {start['rotation'][0]}) > 0.05")
    page.run("headset.controllers.right.updateAxis('thumbstick', 'x-axis', 0);")
    page.run("headset.controllers.right.updateAxis('thumbstick', 'y-axis', -1);")
    page.wait(f"stage.pose.distance < 0.9 * {start['distance']}")
    assert page.problems == []


def test_the_page_continues_after_vr(enter: Callable[[], PlayerPage]) -> None:
    """Catches a page that stays black or frozen after the session, and a button that cannot end the session."""
    page = enter()
    page.run("player.panel.vr.click();")
    page.wait("player.vr === null && !stage.isSuspended")
    page.run("player.seek(3); await player.settled();")
    assert page.run("stage.redraw(); return stage.renderer.readPixels().some((value, i) => i % 4 < 3 && value > 50);")
    assert page.problems == []


def test_a_scene_that_is_closed_ends_vr(enter: Callable[[], PlayerPage]) -> None:
    """Catches a session that draws a scene whose WebGL objects are deleted."""
    page = enter()
    page.run("player.setAttribute('src', 'scene.4dv?again');")
    page.wait("player.vr === null && player.stage !== null && player.firstImageMs > 0")
    assert page.problems == []


def test_a_refused_session_is_a_note(enter: Callable[[], PlayerPage]) -> None:
    """Catches an error of the headset that stops the page or is not shown."""
    page = enter()
    page.run("player.panel.vr.click();")
    page.wait("player.vr === null")
    page.run("navigator.xr.requestSession = async () => { throw new DOMException('busy', 'NotAllowedError'); };")
    page.run("player.panel.vr.click();")
    page.wait("player.panel.message.textContent === 'The browser does not start VR: busy'")
    assert page.run("return stage.isSuspended;") is False
