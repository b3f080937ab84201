"""Stereo pairs of pinhole cameras, and stereo panoramas."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fourd.cli.main import main
from fourd.scene import SceneWriter, open_scene
from fourd.scene.lenses.lens import Panorama
from tests.baking.scenes import manifest, random_frame, write_scene
from tests.viewer.camera_paths.exports import cameras


def render(scene: Path, *words: object) -> None:
    assert main(["render", str(scene), *(str(word) for word in words)]) == 0


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path)).astype(int)


def test_each_eye_has_its_own_image(tmp_path: Path) -> None:
    """Catches exchanged eyes, a wrong distance, and halves in the wrong order."""
    scene = tmp_path / "scene.4dv"
    write_scene(scene)
    words = ("--views", "01", "--frames", "10:11", "--background", 0, 0, 0, "--eye-distance", 0.4)
    render(scene, *words, "--stereo", "side-by-side", "-o", tmp_path / "beside")
    render(scene, *words, "--stereo", "top-bottom", "-o", tmp_path / "above")
    beside, above = (picture(tmp_path / name / "01" / "000010.png") for name in ("beside", "above"))
    with open_scene(scene) as opened:
        camera = opened.manifest.camera("01")
        truths = [
            opened.render(replace(camera, translation=camera.translation - (x, 0, 0))).to_uint8().astype(int)
            for x in (-0.2, 0.2)
        ]
    assert np.abs(beside - np.concatenate(truths, axis=1)).max() <= 1
    assert np.abs(above - np.concatenate(truths, axis=0)).max() <= 1
    assert np.abs(truths[0] - truths[1]).mean() > 1


def test_eyes_converge_at_the_chosen_depth(tmp_path: Path) -> None:
    """Catches a shift of the images in the wrong direction: the point at this depth must have the same place in both
    images, and a nearer point must be farther left for the right eye."""
    scene, camera = tmp_path / "scene.4dv", manifest().source_cameras[0]
    offset = 0.3 * camera.forward
    frame = replace(
        random_frame(2, 6, 0), xyz=np.array([[0, 0, 0], -offset], np.float32), radius=np.full(2, 0.03, np.float16)
    )
    depth = float(camera.forward @ (0 - camera.centre))
    lit = replace(frame, rgb=None if frame.rgb is None else np.full_like(frame.rgb, 255), sh=np.zeros_like(frame.sh))
    for index, visible in enumerate(([0], [1])):
        kept = replace(
            lit, xyz=lit.xyz[visible], radius=lit.radius[visible], density=np.ones(1, np.float16), sh=lit.sh[visible],
            blend_weights=lit.blend_weights[visible], rgb=None if lit.rgb is None else lit.rgb[visible],
        )  # fmt: skip
        with SceneWriter(scene, manifest(6, 1)) as writer:
            writer.add_frame(0, kept)
        words = ("--views", "00", "--stereo", "side-by-side", "--eye-distance", 0.2, "--convergence", depth)
        render(scene, *words, "--background", 0, 0, 0, "--size", 256, 192, "-o", tmp_path / str(index))
    columns = []
    for index in range(2):
        image = picture(tmp_path / str(index) / "00" / "000010.png").sum(axis=2)
        halves = np.split(image, 2, axis=1)
        columns.append([float((half.sum(0) @ np.arange(256)) / half.sum()) for half in halves])
    (left, right), (near_left, near_right) = columns
    assert abs(left - right) < 0.1
    assert near_left - near_right > 1


def test_the_default_distance_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches eyes as far apart as the scene is large, without a word, where the unit of the scene is not known."""
    for unit, expected in (
        (None, "(1/30 of the cameras' distance to the focus)"),
        (0.5, "0.126 world units (0.063 m)"),
    ):
        scene = tmp_path / "scene.4dv"
        with SceneWriter(scene, replace(manifest(6, 1), metres_per_unit=unit)) as writer:
            writer.add_frame(0, random_frame(20, 6, 0))
        render(
            scene, "--path", "orbit", "--steps", 1, "--stereo", "side-by-side", "--size", 32, 32, "-o", tmp_path / "o"
        )
        assert expected in " ".join(capsys.readouterr().err.split())


def test_the_rays_of_a_stereo_panorama_start_at_the_eyes() -> None:
    """Catches a panorama whose stereo effect is right in one direction only, or whose eyes are apart at the poles."""
    camera = replace(cameras()[0], width=64, height=32)
    plain, right = Panorama(1).rays(camera), Panorama(1, 0.1).rays(camera)
    np.testing.assert_array_equal(plain.directions, right.directions)
    offsets = (right.origins - camera.centre).reshape(32, 64, 3)
    directions = right.directions.reshape(32, 64, 3)
    row = offsets[16]
    np.testing.assert_allclose(np.linalg.norm(row, axis=1), 0.1)
    assert np.abs((row * directions[16]).sum(1)).max() < 1e-9, "perpendicular to the view in each direction"
    assert row[32] @ camera.rotation[0] == pytest.approx(0.1, abs=1e-3), "to the right of the viewing direction"
    assert row[0] @ camera.rotation[0] == pytest.approx(-0.1, abs=1e-3), "behind, the head is turned"
    assert np.abs(offsets[[0, -1]]).max() == 0


def test_a_stereo_panorama(tmp_path: Path) -> None:
    """Catches the images of a pair that are equal, and a panorama whose camera is moved as well as its rays."""
    scene = tmp_path / "scene.4dv"
    write_scene(scene)
    words = ("--views", "01", "--frames", "10:11", "--lens", "panorama", "--lens-samples", 1, "--size", 64, 32)
    render(scene, *words, "--stereo", "top-bottom", "--eye-distance", 0.3, "-o", tmp_path / "pair")
    render(scene, *words, "--stereo", "top-bottom", "--eye-distance", 1e-6, "-o", tmp_path / "near")
    render(scene, *words, "-o", tmp_path / "one")
    pair, near, one = (picture(tmp_path / name / "01" / "000010.png") for name in ("pair", "near", "one"))
    assert pair.shape == near.shape == (64, 64, 3)
    assert np.abs(near - np.concatenate([one, one])).max() <= 1
    assert np.abs(pair[:32] - pair[32:]).mean() > 0.1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--eye-distance", "0.1"], "--eye-distance: expected --stereo side-by-side or --stereo top-bottom with it"),
        (["--stereo", "side-by-side", "--convergence", "-1"], "--convergence: expected a distance above 0, got -1"),
        (["--stereo", "top-bottom", "--style", "ink"], "--style, --stereo: expected one of them, got both"),
    ],
)
def test_wrong_options_are_one_line(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches options that have no effect and go unmentioned."""
    write_scene(tmp_path / "scene.4dv")
    given = ["render", str(tmp_path / "scene.4dv"), "--path", "orbit", "-o", str(tmp_path / "out"), *words]
    assert main(given) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
