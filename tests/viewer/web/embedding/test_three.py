"""The example page that shows a scene of fourd in a scene of three.js."""

from __future__ import annotations

import base64
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene import SceneReader
from fourd.scene.player import Player
from fourd.scene.scene import make_frame
from fourd.viewer.publish.site import SCENE_NAME
from tests.viewer.web.conftest import serving
from tests.viewer.web.npm import WEB, installed
from tests.viewer.web.page import IGNORED

SIZE = 96
NEAR, FAR = 0.5, 20.0
PLANE_COLOUR = (0.2, 0.4, 0.8)
SET_VIEW = """
    const {THREE, camera, opaque, transparent, points, renderer, draw, view, gl} = await (
        await import("/web/examples/three/main.js")).example;
    renderer.setAnimationLoop(null);
    opaque.clear();
    transparent.clear();
    opaque.background = new THREE.Color(0);
    camera.matrixWorldAutoUpdate = false;
    camera.matrixWorldInverse.fromArray(argument.view);
    camera.matrixWorld.copy(camera.matrixWorldInverse).invert();
    camera.projectionMatrix.fromArray(argument.projection);
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
    points.matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
    points.clock.isPlaying = false;
    points.clock.seek(0);
    const plane = (depth) => {
        const colour = new THREE.Color().setRGB(...argument.colour, THREE.SRGBColorSpace);
        const mesh = new THREE.Mesh(new THREE.PlaneGeometry(100, 100), new THREE.MeshBasicMaterial({color: colour}));
        mesh.matrixAutoUpdate = false;
        mesh.matrix.copy(camera.matrixWorld).multiply(new THREE.Matrix4().makeTranslation(0, 0, -depth));
        return mesh;
    };
    const settle = async () => {
        do {
            points.update(0, view());
            await new Promise((resolve) => setTimeout(resolve, 5));
        } while (!points.isSettled(view()));
    };
    const pixels = () => {
        draw();
        const bytes = new Uint8Array(4 * gl.drawingBufferWidth * gl.drawingBufferHeight);
        gl.bindFramebuffer(gl.FRAMEBUFFER, null);
        gl.readPixels(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
        return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
    };
"""


class ThreePage:
    """The example page, whose camera and objects a test sets."""

    def __init__(self, page: Any, scene: Path) -> None:
        self.page = page
        reader = SceneReader(scene)
        self.manifest, self.frame = reader.manifest, reader.read(0)
        reader.close()
        self.camera = self.manifest.cameras[-1].resize(SIZE, SIZE)

    def run(self, script: str, depth: float = 0.0) -> Any:
        """Evaluate a function body after the page's objects were removed and its camera was set."""
        argument = {"view": view_matrix(self.camera), "projection": projection_matrix(self.camera)}
        return self.page.evaluate(
            f"async (argument) => {{ {SET_VIEW} {script} }}", {**argument, "colour": PLANE_COLOUR, "depth": depth}
        )

    def image(self, script: str, depth: float) -> NDArray[np.uint8]:
        content = base64.b64decode(self.run(f"{script} await settle(); return pixels();", depth))
        return np.frombuffer(content, np.uint8).reshape(SIZE, SIZE, 4)[::-1, :, :3]

    def expected(self, keep: NDArray[np.bool_], background: tuple[float, float, float]) -> NDArray[np.uint8]:
        """The CPU's image (H, W, 4) of some points."""
        kept = make_frame({name: array[keep] for name, array in self.frame.arrays.items()})
        return Player().draw(kept, self.camera, self.manifest, background=background)

    @property
    def depths(self) -> NDArray[np.float64]:
        camera = self.camera
        return self.frame.xyz @ camera.rotation[2] + camera.translation[2]


def view_matrix(camera: Camera) -> list[float]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = camera.rotation, camera.translation
    return (np.diag([1.0, -1, -1, 1]) @ matrix).ravel("F").tolist()


def projection_matrix(camera: Camera) -> list[float]:
    k, width, height = camera.intrinsics, camera.width, camera.height
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * k[0, 0] / width, 1 - 2 * k[0, 2] / width
    matrix[1, 1], matrix[1, 2] = 2 * k[1, 1] / height, 2 * k[1, 2] / height - 1
    matrix[2, 2:] = (FAR + NEAR) / (NEAR - FAR), 2 * FAR * NEAR / (NEAR - FAR)
    matrix[3, 2] = -1
    return matrix.ravel("F").tolist()


@pytest.fixture
def three_page(browser: Any, object_site: Path, tmp_path: Path) -> Iterator[ThreePage]:
    """The example page with the object scene."""
    package = installed("three")
    shutil.copytree(WEB, tmp_path / "web", ignore=shutil.ignore_patterns("node_modules"))
    modules = tmp_path / "web" / "node_modules" / "three"
    shutil.copytree(package / "build", modules / "build")
    shutil.copytree(package / "examples" / "jsm" / "controls", modules / "examples" / "jsm" / "controls")
    shutil.copyfile(object_site / SCENE_NAME, tmp_path / SCENE_NAME)
    problems: list[str] = []
    with serving(tmp_path) as server:
        context = browser.new_context(viewport={"width": SIZE, "height": SIZE})
        page = context.new_page()
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("console", lambda message: problems.append(message.text))
        page.goto(f"{server.url}web/examples/three/index.html?scene=/{SCENE_NAME}")
        yield ThreePage(page, tmp_path / SCENE_NAME)
        context.close()
    assert [text for text in problems if not any(part in text for part in IGNORED)] == []


def psnr(got: NDArray[np.uint8], expected: NDArray[np.uint8]) -> float:
    error = np.square(got.astype(float) - expected).mean()
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_objects_hide_exactly_the_points_behind_them(share: float, three_page: ThreePage) -> None:
    """Catches hidden points that are drawn or counted as layers, visible points that are missing, and wrong colours."""
    page = three_page
    depth = float(np.quantile(page.depths, share)) + (0.2 if share == 1 else -0.2 if share == 0 else 0.0)
    got = page.image("opaque.add(plane(argument.depth));", depth)
    expected = page.expected(page.depths < depth, PLANE_COLOUR)[..., :3]
    assert psnr(got, expected) >= 40
    if share == 0.4:
        assert psnr(got, page.expected(page.depths > 0, PLANE_COLOUR)[..., :3]) < 30


@pytest.mark.parametrize("is_behind", [True, False])
def test_points_hide_the_objects_that_are_drawn_later(is_behind: bool, three_page: ThreePage) -> None:
    """Catches depth that the points do not write, or write with the wrong sign or scale."""
    page = three_page
    depth = float(page.depths.max() + 0.05 if is_behind else page.depths.min() - 0.05)
    got = page.image("transparent.add(plane(argument.depth));", depth)
    points = page.expected(page.depths > 0, (0, 0, 0))
    plane = np.rint(255 * np.array(PLANE_COLOUR)).astype(np.uint8)
    solid, empty = points[..., 3] > 140, points[..., 3] == 0
    assert solid.sum() > 500
    assert empty.sum() > 500
    assert np.abs(got[empty].astype(int) - plane).max() <= 1
    expected = points[..., :3][solid] if is_behind else np.broadcast_to(plane, (int(solid.sum()), 3))
    assert psnr(got[solid], expected) >= 40


def test_the_example_shows_points_between_the_objects(three_page: ThreePage) -> None:
    """Catches an example page that does not start, or shows no points."""
    page = three_page.page
    script = """async () => {
        const {points, draw, view, gl} = await (await import("/web/examples/three/main.js")).example;
        points.clock.isPlaying = false;
        while (!points.isSettled(view())) await new Promise((resolve) => setTimeout(resolve, 5));
        const image = () => {
            draw();
            const bytes = new Uint8Array(4 * 96 * 96);
            gl.readPixels(0, 0, 96, 96, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
            return bytes;
        };
        const shown = image();
        points.playback.order = null;
        const without = image();
        return shown.filter((value, index) => Math.abs(value - without[index]) > 8).length;
    }"""
    assert page.evaluate(script) > 2000
    assert page.evaluate("document.getElementById('message').textContent") == ""


def test_a_matrix_that_is_no_similarity_is_refused(three_page: ThreePage) -> None:
    """Catches a matrix with a non-uniform scale that is accepted. Points would then be drawn at wrong positions."""
    script = "points.matrix = [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]; draw();"
    with pytest.raises(Exception, match="modelView: expected a rotation, a translation and a uniform scale"):
        three_page.run(script)
    with pytest.raises(Exception, match="projection: expected a perspective projection of OpenGL"):
        three_page.run("camera.projectionMatrix.makeOrthographic(-1, 1, 1, -1, 0, 9); draw();")
