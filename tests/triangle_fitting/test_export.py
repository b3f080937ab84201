"""Files of coloured meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from fourd.base.errors import UserError
from fourd.base.formats.glb import read_glb, srgb_to_linear
from fourd.reconstruction.meshes.triangle_fitting.export import check_format, write_mesh
from fourd.reconstruction.meshes.triangle_fitting.opaque import ColouredMesh


def coloured_box() -> ColouredMesh:
    box = trimesh.creation.box(extents=(1, 2, 3))
    rgb = np.random.default_rng(0).integers(0, 256, (8, 3)).astype(np.uint8)
    return ColouredMesh(np.asarray(box.vertices, np.float32), np.asarray(box.faces, np.int32), rgb)


def test_other_programs_open_the_files(tmp_path: Path) -> None:
    """Catches wrong types, counts and axes, and GLB files whose colours are not linear."""
    mesh = coloured_box()
    for name in ("a.glb", "a.ply"):
        write_mesh(tmp_path / name, mesh, np.array([0.0, 0.0, 1.0]))
    ply = trimesh.load(tmp_path / "a.ply", process=False)
    assert len(ply.faces) == 12
    np.testing.assert_array_equal(ply.visual.vertex_colors[:, :3], mesh.rgb)
    np.testing.assert_allclose(ply.vertices, mesh.xyz)
    glb = trimesh.load(tmp_path / "a.glb", process=False).to_geometry()
    assert len(glb.faces) == 12
    np.testing.assert_allclose(glb.extents, [1, 3, 2], atol=1e-5)
    view = read_glb(tmp_path / "a.glb").view(2)
    stored = np.frombuffer(view, "<u2").reshape(8, 4)
    np.testing.assert_allclose(stored[:, :3] / 65535, srgb_to_linear(mesh.rgb / 255), atol=1e-5)
    assert (stored[:, 3] == 65535).all()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.glb", "a.ply"]


def test_linear_colours() -> None:
    """Catches a gamma of 2.2 instead of the sRGB curve."""
    values = np.array([0.0, 0.04, 0.5, 1.0])
    np.testing.assert_allclose(srgb_to_linear(values), [0, 0.04 / 12.92, 0.214041, 1], atol=1e-6)


def test_file_names_are_checked(tmp_path: Path) -> None:
    """Catches a format that is chosen without a message, and a path that is reported as a folder only after the fit."""
    with pytest.raises(UserError, match=r"a.obj: expected a file name that ends in .glb or .ply, got '.obj'"):
        check_format(tmp_path / "a.obj")
    with pytest.raises(UserError, match="got no suffix"):
        check_format(tmp_path / "mesh")
    (tmp_path / "b.glb").mkdir()
    with pytest.raises(UserError, match="expected a file, got a folder"):
        check_format(tmp_path / "b.glb")
