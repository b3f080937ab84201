"""Export of scenes to the files of other programs, and scenes that are read from such files."""

from __future__ import annotations

import importlib.util
import json
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.cameras import estimate_up
from fourd.base.errors import UserError
from fourd.base.formats.ply import read_ply, write_ply
from fourd.scene import open_scene
from fourd.scene.exporting.export import FORMATS, ExportSettings, Format, export_scene
from fourd.scene.splats.cloud import SplatCloud
from fourd.scene.splats.ply import read_splat_ply, write_splat_ply
from fourd.scene.splats.reader import SplatReader, is_splats
from tests.baking.scenes import write_scene
from tests.viewer.web.npm import installed

PACKAGES = {"spz": "gsply", "usd": "pxr"}


@pytest.fixture
def scene_path(tmp_path: Path) -> Path:
    write_scene(tmp_path / "scene.4dv", points=300)
    return tmp_path / "scene.4dv"


def export(
    scene_path: Path, out: Path, kind: Format, frames: tuple[int, ...] = (0, 1, 2), **options: Any
) -> list[Path]:
    if kind in PACKAGES and importlib.util.find_spec(PACKAGES[kind]) is None:
        pytest.skip(f"the package {PACKAGES[kind]} is not installed")
    with open_scene(scene_path) as scene:
        return list(export_scene(scene, out, ExportSettings(kind, frames, **options)).files)


@pytest.mark.parametrize("kind", [kind for kind in FORMATS if kind != "4dgs"])
def test_every_format_writes_one_file_for_each_frame(scene_path: Path, tmp_path: Path, kind: Format) -> None:
    """Catches file names whose alphabetical order is not the order of frames, and temporary files that remain."""
    files = export(scene_path, tmp_path / "out", kind)
    names = [file.stem for file in files if file.name != "scene.usda"]
    assert names == ["frame_000010", "frame_000011", "frame_000012"]
    assert sorted(file for file in (tmp_path / "out").rglob("*") if file.is_file()) == sorted(files)


def test_up_is_minus_y_in_ply_and_the_scene_looks_the_same(scene_path: Path, tmp_path: Path) -> None:
    """Catches scenes whose up direction is wrong in other programs, and a rotation that does not rotate the
    harmonics.
    """
    (kept,) = export(scene_path, tmp_path / "kept.ply", "ply-sequence", (1,), keep_axes=True)
    (turned,) = export(scene_path, tmp_path / "turned.ply", "ply-sequence", (1,))
    with open_scene(scene_path) as scene:
        up = estimate_up(scene.manifest.cameras)
        frame = scene.frame(1)
    before, after = read_splat_ply(kept), read_splat_ply(turned)
    np.testing.assert_allclose(before.xyz, frame.xyz, atol=1e-6)
    np.testing.assert_allclose(-after.xyz[:, 1], before.xyz @ up, atol=1e-5)
    half_radius = np.repeat(frame.radius[:, None].astype(np.float32) / 2, 3, axis=1)
    np.testing.assert_allclose(before.scale, half_radius, rtol=1e-5)
    np.testing.assert_allclose(before.opacity, frame.density, atol=1e-5)
    np.testing.assert_allclose(after.sh[..., 0], before.sh[..., 0], atol=1e-5)
    assert np.abs(after.sh[..., 1:] - before.sh[..., 1:]).max() > 0.01


def test_exported_colours_are_those_of_the_scene(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a wrong fit of harmonics. Colours that are linear in the harmonics must be reproduced."""
    count = 400
    sh = rng.normal(0, 0.05, (count, 3, 9)).astype(np.float32)
    sh[..., 0] = rng.uniform(-1, 1, (count, 3))
    xyz = rng.normal(0, 0.4, (count, 3)).astype(np.float32)
    rotation = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    cloud = SplatCloud(xyz, np.full((count, 3), 0.03, np.float32), rotation, np.full(count, 0.9, np.float32), sh)
    write_splat_ply(tmp_path / "given.ply", cloud)
    with open_scene(tmp_path / "given.ply") as scene:
        report = export_scene(scene, tmp_path / "again.ply", ExportSettings("ply-sequence", (0,)))
    assert report.psnr is not None
    assert report.psnr > 35
    np.testing.assert_allclose(read_splat_ply(tmp_path / "again.ply").xyz, xyz, atol=1e-6)


def test_glb_has_the_attributes_of_the_extension(scene_path: Path, tmp_path: Path) -> None:
    """Catches wrong offsets, scales that are logarithms, and quaternions in the component order of PLY."""
    (path,) = export(scene_path, tmp_path / "a.glb", "glb", (0,), degree=1)
    content = path.read_bytes()
    length = struct.unpack("<I", content[12:16])[0]
    document = json.loads(content[20 : 20 + length])
    binary = content[28 + length :]
    assert struct.unpack("<I", content[8:12])[0] == len(content)
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]

    def column(name: str) -> NDArray[np.float32]:
        accessor = document["accessors"][primitive["attributes"][name]]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(data, "<f4").reshape(accessor["count"], width)

    (ply,) = export(scene_path, tmp_path / "a.ply", "ply-sequence", (0,), degree=1)
    cloud = read_splat_ply(ply)
    np.testing.assert_allclose(column("POSITION")[:, 1], -cloud.xyz[:, 1], atol=1e-5)
    np.testing.assert_allclose(column("KHR_gaussian_splatting:SCALE"), cloud.scale, rtol=1e-5)
    np.testing.assert_allclose(column("KHR_gaussian_splatting:OPACITY")[:, 0], cloud.opacity, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(column("KHR_gaussian_splatting:ROTATION"), axis=1), 1, atol=1e-5)
    assert column("KHR_gaussian_splatting:SH_DEGREE_1_COEF_2").shape == (len(cloud), 3)
    np.testing.assert_allclose(column("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0"), cloud.sh[..., 0], atol=1e-4)


def test_the_khronos_validator_rejects_only_the_names_of_the_extension(scene_path: Path, tmp_path: Path) -> None:
    """Catches violations of the glTF specification. The validator does not support the extension, and reports its
    attributes as invalid names.
    """
    package = installed("gltf-validator")
    (path,) = export(scene_path, tmp_path / "frame.glb", "glb", (1,))
    program = (
        f"const validator = require({json.dumps(str(package))});"
        f"const bytes = new Uint8Array(require('fs').readFileSync({json.dumps(str(path))}));"
        "const names = ['MESH_PRIMITIVE_INVALID_ATTRIBUTE'];"
        "Promise.all([{}, {ignoredIssues: names}].map((options) => validator.validateBytes(bytes, options)))"
        ".then((reports) => console.log(JSON.stringify(reports.map((report) => report.issues))));"
    )
    printed = subprocess.run(["node", "-e", program], capture_output=True, text=True, check=True)
    strict, tolerant = json.loads(printed.stdout)
    errors = [message for message in strict["messages"] if message["severity"] == 0]
    assert len(errors) == 12
    for message in errors:
        assert message["code"] == "MESH_PRIMITIVE_INVALID_ATTRIBUTE"
        assert "/attributes/KHR_gaussian_splatting:" in message["pointer"]
    assert (tolerant["numErrors"], tolerant["numWarnings"]) == (0, 0), tolerant


def test_spz_has_y_up(scene_path: Path, tmp_path: Path) -> None:
    """Catches a scene that is upside down in programs that read SPZ."""
    (path,) = export(scene_path, tmp_path / "a.spz", "spz", (0,))
    (ply,) = export(scene_path, tmp_path / "a.ply", "ply-sequence", (0,))
    import gsply

    data, cloud = gsply.read_spz(path), read_splat_ply(ply)
    np.testing.assert_allclose(np.asarray(data.means)[:, 1], -cloud.xyz[:, 1], atol=1e-3)
    np.testing.assert_allclose(np.exp(np.asarray(data.scales)), cloud.scale, rtol=0.04)


def test_usd_plays_every_frame(scene_path: Path, tmp_path: Path) -> None:
    """Catches value clips whose paths cannot be resolved, and quaternions in the component order of PLY."""
    files = export(scene_path, tmp_path / "out", "usd")
    from pxr import Usd, UsdVol

    stage = Usd.Stage.Open(str(files[-1]))
    field = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/splats"))
    counts = [len(field.GetPositionsAttr().Get(time)) for time in range(3)]
    assert counts == [300, 301, 302]
    assert len(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(1)) == 9 * 301
    quaternion = field.GetOrientationsAttr().Get(0)[0]
    assert abs(quaternion.GetReal()) ** 2 + quaternion.GetImaginary().GetLength() ** 2 == pytest.approx(1, abs=1e-5)
    (ply,) = export(scene_path, tmp_path / "a.ply", "ply-sequence", (0,))
    np.testing.assert_allclose(
        np.array(field.GetPositionsAttr().Get(0))[:, 1], -read_splat_ply(ply).xyz[:, 1], atol=1e-5
    )


def test_a_folder_of_files_is_a_scene_in_the_order_of_its_numbers(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches files that are sorted by name, so that frame 10 comes before frame 9, and coloured points that are read
    as splats.
    """
    for number in (9, 10, 100):
        count = number
        write_ply(
            tmp_path / f"points_{number}.ply",
            rng.normal(size=(count, 3)),
            rng.integers(0, 256, (count, 3)).astype(np.uint8),
        )
    assert is_splats(tmp_path)
    with open_scene(tmp_path) as scene:
        assert scene.manifest.frame_numbers == (9, 10, 100)
        assert [scene.frame(index).point_count for index in range(3)] == [9, 10, 100]
        image = scene.render(scene.manifest.cameras[0], 2)
    assert image.alpha.max() > 0.5
    np.testing.assert_allclose(estimate_up(scene.manifest.cameras), [0, 0, 1], atol=0.3)


def test_coloured_points_keep_their_colours(scene_path: Path, tmp_path: Path) -> None:
    """Catches colours that are not clamped to bytes."""
    (path,) = export(scene_path, tmp_path / "a.ply", "ply", (0,))
    points = read_ply(path)
    with open_scene(scene_path) as scene:
        np.testing.assert_allclose(points.xyz, scene.frame(0).xyz)
    assert points.rgb.max() > 0


def test_a_folder_whose_second_file_is_broken_names_that_file(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches an error that names only the folder, and frames that are skipped without a message."""
    write_ply(tmp_path / "a_1.ply", rng.normal(size=(5, 3)), np.zeros((5, 3), np.uint8))
    (tmp_path / "a_2.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(UserError, match=r"a_2\.ply: expected an element 'vertex'"):
        SplatReader(tmp_path)
