"""`fourd render --outputs`: opacity, depth and normals as 16-bit PNG and as EXR."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image

from fourd.base.formats.glb_mesh import write_coloured_glb
from fourd.cli.main import main
from fourd.scene import SceneWriter, open_scene
from fourd.scene.meshes.playable import PlayableMeshes
from fourd.scene.styles.normals import encode_octahedral
from fourd.viewer.output.channels import to_linear, write_channel
from tests.baking.meshes.shapes import sphere
from tests.baking.scenes import manifest, write_scene
from tests.viewer.scenes import shell_frame, write_shells

ALL = "rgb,alpha,depth,normal"


def read(path: Path) -> np.ndarray:
    """Read a PNG as (H, W) or RGB, with its own bits, or an EXR as floats."""
    if path.suffix == ".exr":
        with av.open(str(path)) as container:
            return next(container.decode(video=0)).to_ndarray()
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.dtype == np.uint16
    return image if image.ndim == 2 else image[..., ::-1]


def test_the_images_are_those_of_the_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches depths in another unit than the file states, filtered depths, and colours that are not on black."""
    scene = tmp_path / "scene.4dv"
    write_scene(scene)
    assert main(["render", str(scene), "--views", "01,02", "--outputs", ALL, "-o", str(tmp_path / "out")]) == 0
    assert "depth: value * 0.001 world units, up to 65.535; 0 is empty" in " ".join(capsys.readouterr().err.split())
    described = json.loads((tmp_path / "out" / "outputs.json").read_text())
    scale = described["depth"]["world_units_per_step"]
    assert scale == 0.001
    with open_scene(scene) as opened:
        truth = opened.render("02", 1)
    folder = tmp_path / "out" / "02"
    rgb, alpha, depth = (read(folder / kind / "000011.png").astype(float) for kind in ("rgb", "alpha", "depth"))
    assert np.abs(rgb / 65535 - truth.rgb).max() < 1e-4
    assert np.abs(alpha / 65535 - truth.alpha).max() < 1e-4
    assert np.abs(depth * scale - truth.depth).max() <= scale
    assert {path.name for path in folder.iterdir()} == set(ALL.split(","))
    assert len(list((tmp_path / "out").rglob("*.png"))) == 24


def test_exr_files_have_the_numbers_themselves(tmp_path: Path) -> None:
    """Catches halves for floats, colours that stay sRGB, and normals that are coded as in PNG."""
    scene = tmp_path / "scene.4dv"
    write_shells(scene, 1)
    words = ["render", str(scene), "--path", "orbit", "--steps", "1", "--size", "64", "48", "--outputs", ALL]
    assert main([*words, "--image-format", "exr", "-o", str(tmp_path / "exr")]) == 0
    assert main([*words, "-o", str(tmp_path / "png")]) == 0
    exact = {kind: read(tmp_path / "exr" / kind / "000000.exr") for kind in ALL.split(",")}
    whole = {kind: read(tmp_path / "png" / kind / "000000.png").astype(np.float32) for kind in ALL.split(",")}
    assert np.abs(exact["depth"] - 0.001 * whole["depth"]).max() <= 0.00051
    assert np.abs(exact["alpha"] - whole["alpha"] / 65535).max() < 1e-4
    covered = exact["alpha"] > 0
    assert np.abs(exact["normal"] - (2 * whole["normal"] / 65535 - 1))[covered & (exact["depth"] > 0)].max() < 1e-4
    assert not exact["normal"][exact["depth"] == 0].any()
    assert not whole["normal"][exact["depth"] == 0].any()
    opaque = exact["alpha"] > 0.999
    assert opaque.mean() > 0.02
    back = np.where(
        exact["rgb"] > 0.0031308, 1.055 * np.maximum(exact["rgb"], 0) ** (1 / 2.4) - 0.055, 12.92 * exact["rgb"]
    )
    assert np.abs(back - whole["rgb"] / 65535)[opaque].max() < 2e-3


def test_normals_of_points_and_of_meshes_face_outwards(tmp_path: Path) -> None:
    """Catches normals in world axes, and a y or z axis of the wrong sign: on a ball, the normal at the right edge
    points right, at the top edge up, and in the middle towards the camera."""
    frame = shell_frame(3000, 0)
    normals = encode_octahedral(frame.xyz / np.linalg.norm(frame.xyz, axis=1, keepdims=True))
    with SceneWriter(tmp_path / "ball.4dv", manifest(6, 1)) as writer:
        writer.add_frame(0, replace(frame, normals=normals))
    mesh = sphere(rings=24)
    assert mesh.normals is not None
    assert mesh.rgb is not None
    write_coloured_glb(tmp_path / "ball.glb", mesh.xyz, mesh.normals, mesh.rgb, mesh.triangles, np.array([0, 0, 1.0]))
    for name in ("ball.4dv", "ball.glb"):
        out = tmp_path / name.replace(".", "-")
        words = ["--path", "orbit", "--steps", "1", "--size", "96", "96", "--image-format", "exr"]
        assert main(["render", str(tmp_path / name), *words, "--outputs", "normal,alpha,depth", "-o", str(out)]) == 0
        normal, alpha = read(out / "normal" / "000000.exr"), read(out / "alpha" / "000000.exr")
        rows, columns = np.nonzero(alpha > 0.9)
        middle, radius = (rows.mean(), columns.mean()), (columns.max() - columns.min()) / 2
        for (down, right), expected in (((0, 0), (0, 0, 1)), ((0, 0.7), (0.7, 0, 0.7)), ((-0.7, 0), (0, 0.7, 0.7))):
            found = normal[round(middle[0] + down * radius), round(middle[1] + right * radius)]
            assert np.linalg.norm(found) == pytest.approx(1, abs=1e-4)
            assert found @ np.array(expected) / np.linalg.norm(expected) > 0.9, f"{name}: {found} for {expected}"


def test_depths_of_meshes(tmp_path: Path) -> None:
    """Catches sums over the samples of a pixel instead of means."""
    mesh = sphere(rings=12)
    assert mesh.normals is not None
    assert mesh.rgb is not None
    path = tmp_path / "ball.glb"
    write_coloured_glb(path, mesh.xyz, mesh.normals, mesh.rgb, mesh.triangles, np.array([0, 0, 1.0]))
    words = ["--views", "side 1", "--outputs", "depth,rgb", "--image-format", "exr", "--size", "96", "72"]
    assert main(["render", str(path), *words, "-o", str(tmp_path / "out")]) == 0
    depth = read(tmp_path / "out" / "side 1" / "depth" / "000000.exr")
    camera = PlayableMeshes(path).views["side 1"]
    nearest = float((mesh.xyz @ camera.rotation[2] + camera.translation[2]).min())
    assert depth[depth > 0].min() == pytest.approx(nearest, rel=2e-3)


def test_colours_become_linear_without_their_opacity(tmp_path: Path) -> None:
    """Catches dark edges, because premultiplied colours were converted as they are."""
    rgb = np.full((1, 2, 3), 0.5, np.float32) * np.array([1.0, 0.25], np.float32)[None, :, None]
    alpha = np.array([[1.0, 0.25]], np.float32)
    linear = to_linear(rgb, alpha)
    np.testing.assert_allclose(linear[0, 1], linear[0, 0] * 0.25, rtol=1e-6)
    assert linear[0, 0, 0] == pytest.approx(0.2140, abs=1e-4)
    values = np.random.default_rng(0).normal(0, 100, (5, 7, 3)).astype(np.float32)
    write_channel(tmp_path / "a.exr", values)
    np.testing.assert_array_equal(read(tmp_path / "a.exr"), values)


def test_depths_beyond_the_range_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a background whose depths are cut off without a word."""
    write_scene(tmp_path / "scene.4dv")
    words = ["--path", "orbit", "--steps", "2", "--size", "32", "32", "--outputs", "depth", "--depth-scale", "0.00001"]
    assert main(["render", str(tmp_path / "scene.4dv"), *words, "-o", str(tmp_path / "out")]) == 0
    printed = " ".join(capsys.readouterr().err.split())
    assert printed.count("is clamped in the PNG; choose a larger --depth-scale or --image-format exr") == 1
    assert np.asarray(Image.open(tmp_path / "out" / "depth" / "000000.png")).max() == 65535


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--outputs", "rgb,z"], "--outputs: expected names out of rgb, alpha, depth, normal, got 'rgb,z'"),
        (["--outputs", ""], "--outputs: expected names out of"),
        (["--outputs", "depth", "-o", "a.mp4"], "--outputs: expected a folder, got a.mp4"),
        (
            ["--outputs", "depth", "--style", "ink"],
            "--outputs: expected no --lens, --style, --stereo and",
        ),
        (["--image-format", "exr"], "--image-format, --depth-scale: expected --outputs with them, got none"),
        (["--outputs", "depth", "--depth-scale", "nan"], "--depth-scale: expected world units above 0, got nan"),
    ],
)
def test_wrong_options_are_one_line(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches options that have no effect and go unmentioned."""
    write_scene(tmp_path / "scene.4dv")
    out = [] if "-o" in words else ["-o", str(tmp_path / "out")]
    assert main(["render", str(tmp_path / "scene.4dv"), "--path", "orbit", *words, *out]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
