"""Scenes of the tier "video" in the page: sampled colours, damaged images, and browsers without a decoder."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.scene import SceneReader
from fourd.scene.packed.images import HEADER
from fourd.viewer.publish.site import SCENE_NAME, write_site
from tests.baking.scenes import write_full_scene
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage
from tests.viewer.web.test_bad_scenes import with_manifest


@pytest.fixture(scope="module")
def video_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of a scene with a background. The colours of the scene are stored as images. A test that changes the
    site must restore the site."""
    folder = tmp_path_factory.mktemp("video")
    write_full_scene(folder / "scene.4dv", frames=2, points=500, background_points=900)
    write_site(folder / "scene.4dv", folder / "site", "video")
    return folder / "site"


def test_the_page_samples_the_same_colours(video_site: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a projection, rounding, colour conversion or chroma position that differs from the Python reader."""
    reader = SceneReader(video_site / SCENE_NAME)
    with serving(video_site) as server:
        page = open_page(server.url)
        page.pause(1)
        script = "return [...stage.store.get(argument).views].map(([view, rgba]) => [view, [...rgba]]);"
        for number, cloud in ((1, reader.read_dynamic(1)), (-1, reader.read_background())):
            assert cloud is not None
            views = page.run(script, number)
            assert len(views) >= 4
            for view, content in views:
                rgba = np.array(content).reshape(-1, 4)
                difference = np.abs(rgba[:, :3] - cloud.rgb[:, view].astype(int))
                assert difference.max() <= 1
                assert np.mean(difference > 0) < 0.01
                np.testing.assert_array_equal(rgba[:, 3] > 0, cloud.blend_weights[:, view] > 0)
        assert page.problems == []


def test_a_browser_without_a_decoder_is_named(video_site: Path, browser: Any) -> None:
    """Catches a page that stays empty, or an error without a fix, in browsers without WebCodecs."""
    with serving(video_site) as server:
        context = browser.new_context()
        context.add_init_script("delete globalThis.VideoDecoder;")
        message = PlayerPage(context.new_page(), server.url).error()
        context.close()
    assert message.startswith("The scene has the tier video, which needs WebCodecs, and this browser does not offer it")
    assert message.endswith("or write the page with fourd web --tier stream")
    assert "\n" not in message


def with_image(content: bytes, change: Callable[[bytearray], object]) -> bytes:
    """Return the scene with changed images of frame 0, which are appended to the file."""
    out = bytearray(content)

    def relocate(manifest: dict[str, Any]) -> None:
        points = manifest["frames"][0]["points"]
        for name, (offset, size) in manifest["members"].items():
            if name.startswith("frames/000000/views/"):
                member = zlib.decompress(content[offset : offset + size])
                image = bytearray(member[points:])
                change(image)
                compressed = zlib.compress(member[:points] + image)
                manifest["members"][name] = [len(out), len(compressed)]
                out.extend(compressed)

    changed = with_manifest(content, relocate)
    return changed + bytes(out[len(content) :])


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        (2, 2000, "expected an image inside 48 x 48 texels, got 2000 x"),
        (4, 1, "expected an image of 1 bytes, got "),
        (3, 2, "expected a VP9 frame of"),
    ],
)
def test_inconsistent_images(
    field: int, value: int, expected: str, video_site: Path, open_page: Callable[..., PlayerPage]
) -> None:
    """Catches declared sizes of images that the page uses without a check."""
    path = video_site / SCENE_NAME
    content = path.read_bytes()

    def change(image: bytearray) -> None:
        values = list(HEADER.unpack_from(image))
        values[field] = value
        image[: HEADER.size] = HEADER.pack(*values)

    try:
        path.write_bytes(with_image(content, change))
        with serving(video_site) as server:
            message = open_page(server.url).error()
    finally:
        path.write_bytes(content)
    assert message.startswith("frames/000000/views/")
    assert expected in message


def test_a_damaged_frame(video_site: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a page that waits forever for a frame that cannot be decoded."""
    path = video_site / SCENE_NAME
    content = path.read_bytes()

    def change(image: bytearray) -> None:
        image[HEADER.size + 9 :] = b"\xff" * (len(image) - HEADER.size - 9)

    try:
        path.write_bytes(with_image(content, change))
        with serving(video_site) as server:
            message = open_page(server.url).error()
    finally:
        path.write_bytes(content)
    assert "expected an intact VP9 frame" in message
