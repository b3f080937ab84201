"""The readers of the Blender add-on, which need only NumPy, against those of fourd."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fourd.recording.soundtrack.opus import encode_opus
from fourd.scene import SceneReader, SceneWriter
from fourd.scene.files.sound import OpusSound
from fourd.scene.packed.colours import mean_colours
from fourd.scene.packing.pack import pack_scene
from fourd.scene.packing.writer import Storage
from fourd.viewer.blender.addon.manifest import read_manifest
from fourd.viewer.blender.addon.placement import rotation_to_z, up_of
from fourd.viewer.blender.addon.ply_files import list_sequence, read_ply
from fourd.viewer.blender.addon.points import ImportProblem
from fourd.viewer.blender.addon.scene_file import SH_CONSTANT, read_background, read_frame
from fourd.viewer.blender.archive import NAME, write_addon
from tests.baking.scenes import manifest, random_frame, write_full_scene, write_scene

WITHOUT_FOURD = """
import json, sys
sys.modules["fourd"] = None
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from fourd_scenes.manifest import read_manifest
from fourd_scenes.scene_file import read_frame
print(json.dumps(len(read_frame(read_manifest(Path(sys.argv[2])), 0).xyz)))
"""


@pytest.fixture(scope="module", params=["plain", "zstd", "zlib"])
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A full scene of each kind of file."""
    folder = tmp_path_factory.mktemp("scene")
    write_full_scene(folder / "plain.4dv", points=300, background_points=200)
    if request.param != "plain":
        storage = Storage(request.param)
        pack_scene(folder / "plain.4dv", folder / f"{request.param}.4dv", "stream", storage=storage)
    return folder / f"{request.param}.4dv"


def test_points_are_those_of_fourd(scene: Path) -> None:
    """Catches exchanged axes of the Morton code, signs of zigzag codes, and colours that are not weighted."""
    manifest, reader = read_manifest(scene), SceneReader(scene)
    background = reader.read_background()
    assert background is not None
    clouds = [(read_frame(manifest, frame), reader.read_dynamic(frame)) for frame in range(reader.manifest.frame_count)]
    for got, expected in [*clouds, (read_background(manifest), background)]:
        np.testing.assert_allclose(got.xyz, expected.xyz, atol=1e-5)
        np.testing.assert_allclose(got.radius, expected.radius, rtol=2e-3)
        np.testing.assert_allclose(got.density, expected.density, atol=2e-3)
        constant = expected.sh[:, :, 0].astype(np.float32)
        own = reader.manifest.sh_base + reader.manifest.sh_range * np.tanh(SH_CONSTANT * constant)
        colours = np.clip(mean_colours(expected) / 255 + own, 0, 1)
        assert np.abs(got.rgb - colours).mean() < 0.03  # the tier rounds colours
    for view, camera in zip(manifest.views, reader.manifest.cameras, strict=True):
        np.testing.assert_allclose(view.centre, camera.centre)
        np.testing.assert_array_equal(view.intrinsics, camera.intrinsics)
    reader.close()


@pytest.mark.parametrize("is_packed", [False, True])
def test_scenes_with_sound_are_read(tmp_path: Path, *, is_packed: bool) -> None:
    """Catches a scene that the add-on refuses, or reads as packed, because it has sound."""
    path = tmp_path / "scene.4dv"
    with SceneWriter(path, manifest(views=3, frames=2)) as writer:
        for index in range(2):
            writer.add_frame(index, random_frame(40, 3, seed=index))
        writer.add_sound(OpusSound(encode_opus([np.zeros((1, 4000), np.float32)], 1)))
    if is_packed:
        pack_scene(path, path, "stream", storage=Storage("zlib"))
    reader = SceneReader(path)
    assert reader.manifest.sound is not None
    read = read_manifest(path)
    for frame in range(2):
        np.testing.assert_allclose(read_frame(read, frame).xyz, reader.read(frame).xyz, atol=1e-5)
    reader.close()


def test_the_zip_file_needs_no_fourd(scene: Path, tmp_path: Path) -> None:
    """Catches an import of fourd that Blender's Python cannot resolve, and files that differ from run to run."""
    words = [sys.executable, "-m", "fourd.viewer.blender", tmp_path / "addon.zip"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "wrote" in done.stdout
    write_addon(tmp_path / "again.zip")
    assert (tmp_path / "addon.zip").read_bytes() == (tmp_path / "again.zip").read_bytes()
    with zipfile.ZipFile(tmp_path / "addon.zip") as archive:
        assert f"{NAME}/blender_manifest.toml" in archive.namelist()
        assert not [name for name in archive.namelist() if b"fourd.viewer" in archive.read(name)]
        archive.extractall(tmp_path)
        # The package's own __init__ imports bpy only in functions.
    words = [sys.executable, "-c", WITHOUT_FOURD, tmp_path, scene]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == read_manifest(scene).points[0]


def damage(path: Path, out: Path, change: Callable[[dict], object], member: bytes | None = None) -> Path:
    """Write a copy of a scene with another manifest, or with other content of one member."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(out, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "manifest.json":
                values = json.loads(content)
                change(values)
                content = json.dumps(values).encode()
            elif member is not None and name == "frames/000000/xyz":
                content = member
            target.writestr(name, content)
    return out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda values: values.update(version=9), "expected a scene of version 1 to 5, got 9; update the add-on"),
        (lambda values: values.update(frames=[]), "expected at least one frame, got none"),
        (lambda values: values.update(fps="fast"), "expected a number from 0.001 to 10000.0, got fast"),
        (lambda values: values.update(fps=float("nan")), "got nan"),
        (lambda values: values.pop("source_views"), "got a damaged one ('source_views')"),
        (lambda values: values["frames"][0].update(points=10**9), "expected an integer from 0 to 67108864"),
        (lambda values: values["source_views"][0].update(rotation=[1]), "expected finite numbers of the shape (3, 3)"),
    ],
)
def test_damaged_manifests_are_named(tmp_path: Path, change: Callable[[dict], object], message: str) -> None:
    """Catches a traceback in Blender, and memory that is allocated for points that the file does not have."""
    write_scene(tmp_path / "scene.4dv", points=20)
    path = damage(tmp_path / "scene.4dv", tmp_path / "damaged.4dv", change)
    with pytest.raises(ImportProblem) as caught:
        read_manifest(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"short", "frames/000000/xyz: expected 240 bytes, got 5"),
        (np.full(60, np.nan, "<f4").tobytes(), "expected finite points in frames/000000, got NaN or infinity"),
    ],
)
def test_damaged_points_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    """Catches points at infinity, and arrays of another size."""
    write_scene(tmp_path / "scene.4dv", points=20)
    path = damage(tmp_path / "scene.4dv", tmp_path / "damaged.4dv", lambda values: None, content)
    with pytest.raises(ImportProblem) as caught:
        read_frame(read_manifest(path), 0)
    assert message in str(caught.value)


@pytest.mark.parametrize("count", [0, 3, 300, 2000])
def test_cut_files_are_errors(tmp_path: Path, scene: Path, count: int) -> None:
    """Catches an exception of zipfile that reaches Blender as a traceback."""
    path = tmp_path / "cut.4dv"
    path.write_bytes(scene.read_bytes()[:count])
    with pytest.raises(ImportProblem, match=r"expected a \.4dv scene"):
        read_manifest(path)


PLY = "ply\nformat ascii 1.0\nelement vertex {}\n{}end_header\n{}"
XYZ = "property float x\nproperty float y\nproperty float z\n"


def test_ply_sequences(tmp_path: Path) -> None:
    """Catches frames in the order of their names, colours of floats, and radii that do not fit to the spacing."""
    colours = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    rows = "".join(f"{index} 0 0 255 0 128\n" for index in range(5))
    for name in ("f_2", "f_10"):
        (tmp_path / f"{name}.ply").write_text(PLY.format(5, XYZ + colours, rows))
    assert [path.stem for path in list_sequence(tmp_path / "f_10.ply")] == ["f_2", "f_10"]
    cloud = read_ply(tmp_path / "f_2.ply")
    np.testing.assert_allclose(cloud.radius, 1.8)
    np.testing.assert_allclose(cloud.rgb[0], (1, 0, 128 / 255))
    assert cloud.density.tolist() == [1] * 5


@pytest.mark.parametrize(
    "text",
    [
        "no header",
        PLY.format(10**9, XYZ, ""),
        PLY.format(-1, XYZ, ""),
        PLY.format(2, XYZ, "1 2 3\n"),
        PLY.format(1, XYZ, "1 2 nan\n"),
        PLY.format(1, "property float x\n", "1\n"),
        PLY.format(1, "property list uchar int x\n", "1\n"),
        PLY.format(5, XYZ, "").replace("ascii", "binary_little_endian"),
        PLY.format(1, XYZ + XYZ, "1 2 3 1 2 3\n"),
    ],
)
def test_damaged_ply_files_are_errors(tmp_path: Path, text: str) -> None:
    """Catches exceptions of NumPy that reach Blender as a traceback."""
    (tmp_path / "bad.ply").write_text(text)
    with pytest.raises(ImportProblem, match=r"bad\.ply: expected"):
        read_ply(tmp_path / "bad.ply")


def test_up_becomes_z(tmp_path: Path) -> None:
    """Catches a scene that lies on its side, and one that is tilted because its cameras look down."""
    write_scene(tmp_path / "scene.4dv", points=5)
    views = read_manifest(tmp_path / "scene.4dv").views
    np.testing.assert_allclose(up_of("AUTO", views), (0, 0, 1))
    for up in ((0, 0, 1), (0, 0, -1), (0, -1, 0), (0.6, 0, 0.8)):
        rotation = rotation_to_z(np.array(up, np.float64))
        np.testing.assert_allclose(rotation @ up, (0, 0, 1), atol=1e-12)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
