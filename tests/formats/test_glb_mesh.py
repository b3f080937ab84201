"""GLB and PLY files: round trips, the animation, axes, and damaged files."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from fourd.base.errors import UserError
from fourd.base.formats.glb import read_glb, up_rotation
from fourd.base.formats.glb_animation import write_animation
from fourd.base.formats.glb_mesh import encode_texture, read_glb_mesh, write_textured_glb
from fourd.base.formats.mesh import Mesh
from fourd.base.formats.ply import write_ply

Z_UP = np.array([0.0, 0.0, 2.0])


def textured_box(side: float = 1.0) -> Mesh:
    box = trimesh.creation.box(extents=(side, 2 * side, 3 * side))
    xyz = np.asarray(box.vertices, np.float32)
    ramp = np.linspace(0, 255, 32, dtype=np.uint8)
    texture = np.stack([np.broadcast_to(ramp, (32, 32)), np.broadcast_to(ramp[:, None], (32, 32))], axis=-1)
    return Mesh(
        xyz,
        np.asarray(box.faces, np.int32),
        xyz / np.linalg.norm(xyz, axis=1, keepdims=True),
        uv=(xyz[:, :2] / (2 * side) / 2 + 0.5).astype(np.float32),
        texture=np.concatenate([texture, np.full((32, 32, 1), 90, np.uint8)], axis=-1),
        up=Z_UP,
    )


def write_glb(path: Path, mesh: Mesh) -> None:
    assert mesh.normals is not None
    assert mesh.uv is not None
    assert mesh.texture is not None
    write_textured_glb(path, mesh.xyz, mesh.normals, mesh.uv, mesh.texture, mesh.triangles, mesh.up)


def test_glb_round_trip(tmp_path: Path) -> None:
    """Catches arrays that are stored with a wrong type, order or offset."""
    mesh = textured_box()
    write_glb(tmp_path / "a.glb", mesh)
    read = read_glb_mesh(tmp_path / "a.glb")
    for name in ("xyz", "triangles", "uv"):
        np.testing.assert_array_equal(getattr(read, name), getattr(mesh, name))
    np.testing.assert_allclose(read.normals, mesh.normals, atol=1e-6)
    np.testing.assert_allclose(read.up, (0, 0, 1), atol=1e-12)
    assert read.texture is not None
    assert np.abs(read.texture.astype(int) - mesh.texture).max() <= 6
    assert [path.name for path in tmp_path.iterdir()] == ["a.glb"]


def test_other_programs_see_the_up_direction_and_the_texture(tmp_path: Path) -> None:
    """Catches axes that are not y-up, and a texture that is upside down or has swapped channels."""
    mesh = textured_box()
    write_glb(tmp_path / "a.glb", mesh)
    loaded = trimesh.load(tmp_path / "a.glb").to_geometry()
    np.testing.assert_allclose(loaded.extents, [1, 3, 2], atol=1e-5)
    assert loaded.is_volume
    picture = np.asarray(loaded.visual.material.baseColorTexture)
    assert np.abs(picture.astype(int) - mesh.texture).max() <= 6
    # trimesh measures v upwards, glTF downwards.
    np.testing.assert_allclose(1 - loaded.visual.uv[:, 1], mesh.uv[:, 1], atol=1e-6)


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, -3), (1, 2, -0.5)])
def test_the_up_direction_becomes_y(up: tuple[float, float, float]) -> None:
    """Catches a rotation that has the opposite direction, or that is undefined for -y."""
    x, y, z, w = up_rotation(np.array(up, float))
    matrix = trimesh.transformations.quaternion_matrix([w, x, y, z])[:3, :3]
    np.testing.assert_allclose(matrix @ np.array(up) / np.linalg.norm(up), [0, 1, 0], atol=1e-12)


def test_exactly_one_frame_of_the_animation_is_shown_at_any_time(tmp_path: Path) -> None:
    """Catches frames that overlap, gaps between frames, and accessors that point into another frame."""
    paths = [tmp_path / f"{number:06d}.glb" for number in range(3)]
    for number, path in enumerate(paths):
        write_glb(path, textured_box(1.0 + number))
    write_animation(tmp_path / "animation.glb", paths, 10.0, Z_UP)
    file = read_glb(tmp_path / "animation.glb")
    document = file.document
    animation, accessors = document["animations"][0], document["accessors"]
    tracks = []
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        times, scales = (
            np.frombuffer(file.view(accessors[sampler[key]]["bufferView"]), "<f4") for key in ("input", "output")
        )
        assert (np.diff(times) > 0).all()
        tracks.append((times, scales.reshape(-1, 3)))
    for time in np.arange(0.001, 0.3, 0.01):
        shown = [float(scales[np.searchsorted(times, time, side="right") - 1].sum()) / 3 for times, scales in tracks]
        assert shown == [float(index == int(time * 10)) for index in range(3)], time
    loaded = trimesh.load(tmp_path / "animation.glb")
    extents = sorted(float(geometry.extents[0]) for geometry in loaded.geometry.values())
    assert extents == pytest.approx([1, 2, 3])
    assert sum(len(node.get("children", [])) for node in document["nodes"]) == 3


def test_khronos_validator_accepts_the_files(tmp_path: Path) -> None:
    """Catches violations of the glTF specification. The test needs the npm package gltf-validator."""
    node = shutil.which("node")
    script = "require('gltf-validator')"
    if node is None or subprocess.run([node, "-e", script], cwd=tmp_path, capture_output=True).returncode != 0:
        pytest.skip("node or the npm package gltf-validator is not installed (NODE_PATH names its folder)")
    paths = [tmp_path / "a.glb", tmp_path / "b.glb"]
    for path in paths:
        write_glb(path, textured_box())
    write_animation(tmp_path / "animation.glb", paths, 24.0, Z_UP)
    for path in (*paths, tmp_path / "animation.glb"):
        program = (
            f"const b = new Uint8Array(require('fs').readFileSync({json.dumps(str(path))}));"
            f"{script}.validateBytes(b).then(r => console.log(JSON.stringify(r.issues)))"
        )
        printed = subprocess.run([node, "-e", program], cwd=tmp_path, capture_output=True, text=True, check=True)
        issues = json.loads(printed.stdout)
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues


def test_ply_opens_in_other_programs(tmp_path: Path) -> None:
    """Catches a wrong header or a wrong layout of rows."""
    mesh = textured_box()
    rgb = np.arange(24, dtype=np.uint8).reshape(8, 3)
    write_ply(tmp_path / "a.ply", mesh.xyz, rgb, mesh.normals, mesh.triangles)
    loaded = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(loaded.vertices, mesh.xyz)
    np.testing.assert_array_equal(loaded.faces, mesh.triangles)
    np.testing.assert_array_equal(loaded.visual.vertex_colors[:, :3], rgb)


def test_frames_of_an_animation_are_checked(tmp_path: Path) -> None:
    """Catches a traceback, or a message without the file's name, for frames that are missing, cut or no meshes."""
    path, out = tmp_path / "a.glb", tmp_path / "b.glb"
    with pytest.raises(UserError, match=r"a\.glb: expected a GLB file, got 'No such file"):
        write_animation(out, [path], 10.0, Z_UP)
    write_glb(path, textured_box())
    with pytest.raises(ValueError, match="frames: expected at least one"):
        write_animation(out, [], 10.0, Z_UP)
    with pytest.raises(ValueError, match="fps: expected more than 0"):
        write_animation(out, [path], 0.0, Z_UP)
    content = path.read_bytes()
    for damaged in (b"", b"no mesh at all, but text", content[:-7], content[:30], b"\0" + content[1:]):
        path.write_bytes(damaged)
        with pytest.raises(UserError, match=r"a\.glb: expected [^\n]*; write the file again"):
            write_animation(out, [path], 10.0, Z_UP)
    length = struct.unpack("<I", content[12:16])[0]
    other = json.loads(content[20 : 20 + length])
    other["meshes"] = []
    text = json.dumps(other, separators=(",", ":")).encode().ljust(length)
    path.write_bytes(content[:20] + text + content[20 + length :])
    with pytest.raises(UserError, match=r"a\.glb: expected a mesh that fourd wrote, got a file of another structure"):
        write_animation(out, [path], 10.0, Z_UP)


def test_colours_of_the_texture_survive_jpeg() -> None:
    """Catches swapped red and blue channels in the encoder."""
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 200
    decoded = cv2.imdecode(np.frombuffer(encode_texture(red), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert decoded is not None
    assert np.abs(decoded.astype(int) - red).max() < 8
