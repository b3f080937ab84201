"""PLY files that fourd wrote, PLY files that other programs wrote, and damaged PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from fourd.base.errors import UserError
from fourd.base.formats.ply import read_ply, write_ply


def cloud(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    return rng.normal(size=(count, 3)).astype(np.float32), rng.integers(0, 256, (count, 3), dtype=np.uint8)


@pytest.mark.parametrize("count", [0, 1, 1000])
def test_round_trip(count: int, tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches swapped channels and lost precision."""
    xyz, rgb = cloud(rng, count)
    write_ply(tmp_path / "a.ply", xyz, rgb)
    read = read_ply(tmp_path / "a.ply")
    assert np.array_equal(read.xyz, xyz)
    assert np.array_equal(read.rgb, rgb)


def test_trimesh_and_fourd_read_each_others_files(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches PLY files that other programs cannot read."""
    xyz, rgb = cloud(rng, 50)
    write_ply(tmp_path / "ours.ply", xyz, rgb)
    theirs = trimesh.load(tmp_path / "ours.ply")
    assert np.allclose(theirs.vertices, xyz)
    assert np.array_equal(np.asarray(theirs.colors)[:, :3], rgb)
    trimesh.PointCloud(xyz, np.column_stack([rgb, np.full(50, 255, np.uint8)])).export(tmp_path / "theirs.ply")
    read = read_ply(tmp_path / "theirs.ply")
    assert np.allclose(read.xyz, xyz)
    assert np.array_equal(read.rgb, rgb)


def test_ascii_with_additional_properties(tmp_path: Path) -> None:
    """Catches a reader that relies on the order of the columns. Scanners write additional columns for normals and
    confidences."""
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 2\nproperty float nx\nproperty double x\n"
        "property float y\nproperty float z\nproperty uchar blue\nproperty uchar green\nproperty uchar red\n"
        "end_header\n9 1 2 3 10 20 30\n9 4 5 6 40 50 60\n"
    )
    read = read_ply(tmp_path / "a.ply")
    assert read.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert read.rgb.tolist() == [[30, 20, 10], [60, 50, 40]]


XYZ = b"property float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello",
        b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n1\n2\n3\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 9999999999999\nproperty float x\nproperty float y\n"
        b"property float z\nend_header\n" + bytes(24),
        b"ply\nformat ascii 1.0\nelement vertex -4\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        b"ply\nformat ascii 1.0\nelement vertex 1\n" + XYZ + b"end_header\n1 a 3",
        b"ply\nformat ascii 1.0\nelement vertex 1\n" + XYZ + b"end_header\n1 nan 3",
        b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n" * 9000,
    ],
)
def test_damaged_files_are_user_errors(content: bytes, tmp_path: Path) -> None:
    """Catches a crash, and memory that is allocated for a wrong number of points in the header."""
    path = tmp_path / "bad.ply"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"bad\.ply: ") as caught:
        read_ply(path)
    assert "\n" not in str(caught.value)


def test_truncated_files_are_user_errors(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a truncated PLY file that is accepted as a complete file."""
    path = tmp_path / "bad.ply"
    write_ply(path, *cloud(rng, 20))
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(UserError):
            read_ply(path)
