"""`fourd render` with meshes: files of every writer, sequences, styles, and bad input."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from fourd.base.errors import UserError
from fourd.base.formats.glb_animation import write_animation
from fourd.base.formats.glb_mesh import read_glb_mesh, write_coloured_glb, write_textured_glb
from fourd.base.formats.mesh import Mesh
from fourd.base.formats.ply import write_ply
from fourd.base.formats.ply_mesh import read_ply_mesh
from fourd.cli.main import main
from fourd.scene.meshes.source import is_mesh
from tests.baking.meshes.shapes import plane, sphere
from tests.cli.extras.test_without_training_packages import run_without_training_packages

UP = np.array([0.3, -0.8, 0.5]) / np.linalg.norm([0.3, -0.8, 0.5])


def write_as(path: Path, mesh: Mesh) -> Path:
    assert mesh.normals is not None
    assert mesh.rgb is not None
    if path.suffix == ".ply":
        write_ply(path, mesh.xyz, mesh.rgb, mesh.normals, mesh.triangles)
    else:
        write_coloured_glb(path, mesh.xyz, mesh.normals, mesh.rgb, mesh.triangles, UP)
    return path


def write_textured(path: Path) -> Path:
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:, :32], texture[:, 32:] = (250, 40, 40), (40, 40, 250)
    mesh = plane((0, 0, -1), texture)
    assert mesh.uv is not None
    assert mesh.normals is not None
    write_textured_glb(path, mesh.xyz, mesh.normals, mesh.uv, texture, mesh.triangles, UP)
    return path


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_files_are_read_as_they_were_written(suffix: str, tmp_path: Path) -> None:
    """Catches colours that stay linear, a wrong up direction, and vertices whose order does not match the triangles."""
    mesh = sphere(rings=12)
    path = write_as(tmp_path / f"mesh{suffix}", mesh)
    found = read_ply_mesh(path) if suffix == ".ply" else read_glb_mesh(path)
    np.testing.assert_array_equal(found.xyz, mesh.xyz)
    np.testing.assert_array_equal(found.triangles, mesh.triangles)
    np.testing.assert_array_equal(found.rgb, mesh.rgb)
    np.testing.assert_allclose(found.normals, mesh.normals, atol=1e-6)
    np.testing.assert_allclose(found.up, UP if suffix == ".glb" else (0, 0, 1), atol=1e-6)


def test_textured_files_and_ascii_files(tmp_path: Path) -> None:
    """Catches a texture that is lost, and PLY files of other programs."""
    found = read_glb_mesh(write_textured(tmp_path / "mesh.glb"))
    np.testing.assert_allclose(found.uv, plane((0, 0, -1), np.zeros((64, 64, 3), np.uint8)).uv)
    assert np.abs(found.texture[32, [8, 56]].astype(int) - [[250, 40, 40], [40, 40, 250]]).max() < 12
    (tmp_path / "mesh.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    mesh = read_ply_mesh(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2]])
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 3)
    assert mesh.rgb is None


@pytest.mark.parametrize("suffix", [".ply", ".glb"])
def test_a_mesh_is_drawn_in_a_style_without_torch(suffix: str, tmp_path: Path) -> None:
    """Catches a mesh PLY that is drawn as points, a style without outline, and a command that imports torch."""
    path = write_as(tmp_path / f"mesh{suffix}", sphere(rings=60, colour=(250, 250, 250)))
    words = ["render", str(path), "--views", "side 1", "--size", "192", "144", "--background", "1", "1", "1"]
    for name, style in (("plain", []), ("toon", ["--style", "toon"])):
        done = run_without_training_packages(*words, *style, "-o", str(tmp_path / name))
        assert done.returncode == 0, done.stderr[-2000:]
    plain, toon = (picture(tmp_path / name / "side 1" / "000000.png") for name in ("plain", "toon"))
    assert plain.min() > 240
    # The outline is a closed ring: every row that the sphere covers has a dark pixel on both sides.
    dark = toon.max(2) < 60
    rows = np.flatnonzero(dark.any(1))
    assert len(rows) > 60
    assert (np.diff(rows) == 1).all()
    for row in rows[3:-3]:
        columns = np.flatnonzero(dark[row])
        assert columns[0] < 96 < columns[-1]
    middle = toon[72, 80:112]
    assert (middle > 60).all()


def test_sequences_orbit_and_video(tmp_path: Path) -> None:
    """Catches frames that are sorted by name instead of number, and a video without frames. Also catches an animation
    file that is read as a frame.
    """
    folder = tmp_path / "meshes"
    folder.mkdir()
    for number, radius in ((2, 0.3), (10, 1.0), (1, 0.6)):
        write_as(folder / f"mesh{number}.glb", sphere(radius, rings=16))
    (folder / "animation.glb").write_bytes(b"not read")
    words = ["render", str(folder), "--size", "96", "72", "--background", "0", "0", "0"]
    assert main([*words, "--views", "side 3", "-o", str(tmp_path / "views")]) == 0
    covered = [(picture(tmp_path / "views" / "side 3" / f"{number:06d}.png") > 0).sum() for number in (1, 2, 10)]
    assert covered[1] < covered[0] < covered[2]
    assert main([*words, "--path", "orbit", "--steps", "4", "--style", "ink", "-o", str(tmp_path / "orbit.mp4")]) == 0
    video = cv2.VideoCapture(str(tmp_path / "orbit.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 4


def test_the_window_names_the_command_for_meshes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a folder of meshes that is opened as a run, and a mesh that is read as a scene."""
    path = write_as(tmp_path / "mesh.glb", sphere(rings=5))
    for source in (path, tmp_path):
        assert main(["view", str(source), "--screenshot", str(tmp_path / "out.png")]) == 2
        expected = f"{source}: expected a scene or a run, got meshes, which are not points; draw them with fourd render"
        assert expected in capsys.readouterr().err


def test_points_are_not_meshes(tmp_path: Path) -> None:
    """Catches point clouds that are drawn as meshes."""
    write_ply(tmp_path / "points.ply", np.random.default_rng(1).normal(size=(20, 3)), np.zeros((20, 3), np.uint8))
    assert not is_mesh(tmp_path / "points.ply")
    assert not is_mesh(tmp_path)
    write_as(tmp_path / "mesh.glb", sphere(rings=5))
    assert is_mesh(tmp_path)


def changed(path: Path, change: object) -> bytes:
    """The bytes of a GLB file with a changed document."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + length])
    change(document)  # type: ignore[operator]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    return struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: d["accessors"][3].update(count=10**9), "which cannot contain them"),
        (lambda d: d["accessors"][3].update(count=4), "expected three indices for each triangle, got 4 indices"),
        (lambda d: d["accessors"][0].update(count=3), "expected normals of shape (3, 3), got"),
        (lambda d: d["bufferViews"][0].update(byteOffset=10**9), "bytes of binary data, got"),
        (lambda d: d["bufferViews"][0].update(byteOffset=-4), "expected whole numbers from 0"),
        (lambda d: d["accessors"][0].update(componentType=1), "a file without 1"),
        (lambda d: d["meshes"].append(d["meshes"][0]), "expected one mesh, got 2 meshes"),
        (lambda d: d["nodes"][1].update(scale=[2, 2, 2]), "expected nodes that only rotate"),
        (lambda d: d.pop("meshes"), "a file without 'meshes'"),
        (lambda d: d.update(meshes=3), "expected a mesh that fourd wrote"),
        (lambda d: d["meshes"][0]["primitives"][0].update(mode=0), "expected triangles, got points or lines"),
        (lambda d: d["nodes"][0].update(rotation=[0, 0, 0, 9]), "expected a unit quaternion"),
    ],
)
def test_inconsistent_glb_files(change: object, expected: str, tmp_path: Path) -> None:
    """Catches a reader that uses the counts, offsets and indices of a file without a check."""
    path = write_as(tmp_path / "mesh.glb", sphere(rings=6))
    path.write_bytes(changed(path, change))
    with pytest.raises(UserError) as error:
        read_glb_mesh(path)
    assert str(error.value).startswith(str(path))
    assert expected in str(error.value)
    assert "\n" not in str(error.value)


def test_a_texture_that_is_damaged(tmp_path: Path) -> None:
    """Catches a texture that ends the command with a traceback."""
    path = write_textured(tmp_path / "mesh.glb")
    path.write_bytes(changed(path, lambda d: d["images"][0].update(bufferView=0)))
    with pytest.raises(UserError, match="expected a JPEG or PNG as texture, got a damaged image"):
        read_glb_mesh(path)


def test_a_texture_that_is_too_large(tmp_path: Path) -> None:
    """Catches a texture whose size is not checked, and a limit that the caller cannot raise."""
    mesh = plane((0, 0, -1), np.zeros((2, 9000, 3), np.uint8))
    assert mesh.normals is not None
    assert mesh.uv is not None
    assert mesh.texture is not None
    path = tmp_path / "mesh.glb"
    write_textured_glb(path, mesh.xyz, mesh.normals, mesh.uv, mesh.texture, mesh.triangles, UP)
    with pytest.raises(UserError, match="expected a texture of at most 8192 texels per side, got 9000 x 2;"):
        read_glb_mesh(path)
    found = read_glb_mesh(path, 9000)
    assert found.texture is not None
    assert found.texture.shape == (2, 9000, 3)


def test_damaged_files_end_with_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback for files that are truncated, missing, not meshes, or have indices out of range."""
    good = write_as(tmp_path / "good.glb", sphere(rings=6)).read_bytes()
    mesh = sphere(rings=6)
    mesh.triangles[3, 1] = len(mesh.xyz)
    ply = write_as(tmp_path / "wrong.ply", mesh).read_bytes()
    write_animation(tmp_path / "all.glb", [write_textured(tmp_path / f"{index}.glb") for index in range(2)], 24.0, UP)
    for name, content, expected in (
        ("wrong.ply", ply, "expected vertex indices from 0 to"),
        ("short.ply", ply[:-5], "triangles, got other polygons, or a truncated file"),
        ("short.glb", good[:-7], "according to the header, got"),
        ("other.glb", b"x" * 100, "expected a GLB file of version 2"),
        ("empty.glb", b"", "expected an intact GLB file"),
        ("none.glb", None, "No such file"),
        ("all.glb", (tmp_path / "all.glb").read_bytes(), "expected one mesh, got 2 meshes, as in an animation"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        assert main(["render", str(tmp_path / name), "--path", "orbit", "-o", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert expected in error, error
        assert len(error.strip().splitlines()) == 1
    assert main(["render", str(tmp_path / "good.glb"), "--views", "05", "-o", str(tmp_path / "out")]) == 2
    assert "--views: expected names out of side 1, side 2" in capsys.readouterr().err
