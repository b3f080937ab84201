"""The web player's images compared with the player on the CPU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.scene import SceneReader, SceneWriter
from fourd.scene.files.encoding import Tier
from fourd.scene.player import Player
from fourd.viewer.publish.site import SCENE_NAME, write_site
from tests.baking.scenes import NEAR_IN_BALL, manifest, random_frame, write_scene
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage

SIZE = 96
MIN_PSNR = {"sorted": 40.0, "reference": 50.0}


def images(page: PlayerPage, scene: Path, frame: int, mode: str, layers: int = 12) -> tuple[NDArray, NDArray]:
    """The images (H, W, 3) of the page and of the CPU, from the last camera of the scene, between two source views."""
    reader = SceneReader(scene)
    camera = reader.manifest.cameras[-1].resize(SIZE, SIZE)
    expected = Player().draw(reader.read(frame), camera, reader.manifest, layers=layers)[..., :3]
    reader.close()
    page.pause(frame)
    page.run("stage.layers = argument;", layers)
    return page.pixels(camera, mode), expected


def psnr(got: NDArray[np.uint8], expected: NDArray[np.uint8]) -> float:
    error = np.square(got.astype(float) - expected).mean()
    return float(10 * np.log10(255**2 / max(error, 1e-9)))


@pytest.mark.parametrize("mode", ["sorted", "reference"])
@pytest.mark.parametrize("kind", ["object", "full"])
def test_images_equal_those_of_the_cpu(
    kind: str, mode: str, request: pytest.FixtureRequest, open_page: Callable[..., PlayerPage]
) -> None:
    """Catches a wrong projection, decoding, order, view blend, SH or shadow, and a wrong number of layers."""
    site = request.getfixturevalue(f"{kind}_site")
    with serving(site) as server:
        page = open_page(server.url, (SIZE, SIZE))
        for frame in (2, 0):
            got, expected = images(page, site / SCENE_NAME, frame, mode)
            assert expected.std() > 20
            assert psnr(got, expected) >= MIN_PSNR[mode]
    assert page.problems == []


def test_both_modes_composite_exactly_k_layers(object_site: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a stencil test that composites one layer too many or too few."""
    with serving(object_site) as server:
        page = open_page(server.url, (SIZE, SIZE))
        for mode in ("sorted", "reference"):
            got, expected = images(page, object_site / SCENE_NAME, 1, mode, layers=2)
            _, other = images(page, object_site / SCENE_NAME, 1, mode, layers=3)
            assert psnr(got, expected) > 45 > 40 > psnr(other, expected)


def test_discs_that_are_too_large_for_sprites(object_site: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches wrong images of nearby points, which are drawn as quads because drivers limit the size of sprites."""
    with serving(object_site) as server:
        page = open_page(server.url, (SIZE, SIZE))
        page.ready()
        page.run("stage.renderer.points.discs.maxSprite = 0;")
        for mode in ("sorted", "reference"):
            got, expected = images(page, object_site / SCENE_NAME, 0, mode)
            assert psnr(got, expected) >= MIN_PSNR[mode]


@pytest.mark.parametrize("mode", ["sorted", "reference"])
def test_points_fade_at_the_near_plane(mode: str, tmp_path: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a page that cuts points off where the other players fade them."""
    with SceneWriter(tmp_path / "scene.4dv", replace(manifest(6, 1), near=NEAR_IN_BALL)) as writer:
        writer.add_frame(0, random_frame(4000, 6, seed=1))
    write_site(tmp_path / "scene.4dv", tmp_path / "site", "full")
    with serving(tmp_path / "site") as server:
        page = open_page(server.url, (SIZE, SIZE))
        got, expected = images(page, tmp_path / "site" / SCENE_NAME, 0, mode)
    assert expected.std() > 20
    assert psnr(got, expected) >= MIN_PSNR[mode]


@pytest.mark.parametrize("tier", ["stream", "video", "light"])
def test_tiers(tier: Tier, tmp_path: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a tier that the page cannot read, such as a scene without source views."""
    write_scene(tmp_path / "scene.4dv", frames=1, points=500)
    write_site(tmp_path / "scene.4dv", tmp_path / "site", tier)
    with serving(tmp_path / "site") as server:
        page = open_page(server.url, (SIZE, SIZE))
        got, expected = images(page, tmp_path / "site" / SCENE_NAME, 0, "sorted")
    assert psnr(got, expected) >= MIN_PSNR["sorted"]


def test_orbit_equals_the_viewer(play: PlayerPage) -> None:
    """Catches a drag whose effect on the view differs from that in the viewer's window."""
    from fourd.viewer.navigation.pose import Pose

    page = play
    state = page.run("return player.stage.pose;")
    start = Pose(
        np.array(state["pivot"]),
        np.array(state["rotation"]).reshape(3, 3),
        state["distance"],
        state["fieldOfView"],
        np.array(state["up"]),
        tuple(state["offset"]),
    )
    moved = start.orbit(0.3, -0.2).pan(0.1, 0.05).dolly(0.8).fly(0.1, 0.2, 0.3)
    script = """
        const {orbit, pan, dolly, fly, eyeOf} = await import("/player/navigate/pose.js");
        const moved = fly(dolly(pan(orbit(stage.pose, 0.3, -0.2), 0.1, 0.05), 0.8), 0.1, 0.2, 0.3);
        return {...moved, eye: eyeOf(moved)};
    """
    got = page.run(script)
    np.testing.assert_allclose(got["eye"], moved.eye, atol=1e-9)
    np.testing.assert_allclose(np.reshape(got["rotation"], (3, 3)), moved.rotation, atol=1e-9)
    assert replace(moved, pivot=np.array(got["pivot"])).eye == pytest.approx(moved.eye, abs=1e-9)
