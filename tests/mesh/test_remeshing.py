"""Isotropic remeshing by gpytoolbox."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from fourd.reconstruction.meshes.surface import remeshing
from fourd.reconstruction.meshes.surface.remeshing import remesh

BOX = trimesh.creation.box(extents=(1, 0.6, 0.4)).subdivide().subdivide()
XYZ, FACES = np.asarray(BOX.vertices, np.float32), np.asarray(BOX.faces, np.int64)


def test_edges_have_the_wanted_length() -> None:
    """Catches a length in the wrong unit, flipped triangles and open meshes."""
    pytest.importorskip("gpytoolbox")
    xyz, triangles = remesh(XYZ, FACES, 0.08)
    mesh = trimesh.Trimesh(xyz, triangles, process=False)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.24, rel=0.03)
    assert mesh.edges_unique_length.mean() == pytest.approx(0.08, rel=0.15)
    assert mesh.edges_unique_length.std() < 0.25 * 0.08


def test_bad_arguments_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches messages that do not name the argument or the missing package."""
    with pytest.raises(ValueError, match="edge_length: expected more than 0"):
        remesh(XYZ, FACES, 0.0)
    with pytest.raises(ValueError, match="triangles: expected at least one triangle"):
        remesh(XYZ, FACES[:0], 0.1)
    with pytest.raises(ValueError, match="xyz: expected finite vertices"):
        remesh(XYZ * np.nan, FACES, 0.1)
    monkeypatch.setattr(remeshing, "remeshing_is_available", lambda: False)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'fourd\[mesh\]'"):
        remesh(XYZ, FACES, 0.1)
