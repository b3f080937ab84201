"""The add-on in Blender, as the Python module bpy.

It runs with the Python that FOURD_BPY_PYTHON names, or with the Python of the tests if that has bpy.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fourd.base.formats.ply import write_ply
from fourd.scene import open_scene
from fourd.viewer.blender.archive import write_addon

SCENE = Path(__file__).parents[3] / "docs" / "scenes" / "runner.4dv"
SCRIPT = Path(__file__).with_name("in_blender.py")
MIN_PSNR = 35.0
"""Measured: 38.3 and 38.6 dB. The pictures differ in the colours that depend on the direction, and at contours."""
MAX_GROWTH_MB = 8.0


@pytest.fixture
def blender() -> str:
    """The path of a Python that has bpy."""
    python = os.environ.get("FOURD_BPY_PYTHON")
    if python is None and importlib.util.find_spec("bpy") is not None:
        python = sys.executable
    if python is None:
        pytest.skip("no bpy here: pip install bpy in an environment, and set FOURD_BPY_PYTHON to its Python")
    return python


def test_blender_shows_what_fourd_renders(blender: str, tmp_path: Path) -> None:
    """Catches cameras with wrong axes or principal points, colours of another transfer function, frames that do not
    change, points that pile up in memory, and errors of several lines."""
    write_addon(tmp_path / "addon.zip")
    with zipfile.ZipFile(tmp_path / "addon.zip") as archive:
        archive.extractall(tmp_path / "addon")
    scene = tmp_path / "runner.4dv"
    shutil.copyfile(SCENE, scene)
    (tmp_path / "text.4dv").write_text("no scene")
    (tmp_path / "bad.ply").write_text("ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nend_header\n1\n")
    (tmp_path / "ply").mkdir()
    for frame in (1, 2):
        xyz = np.full((10 * frame, 3), (0.0, 1.0, 0.0))
        write_ply(tmp_path / "ply" / f"{frame:06d}.ply", xyz, np.zeros((10 * frame, 3), np.uint8))
    words = [blender, SCRIPT, tmp_path / "addon", scene, tmp_path / "ply", tmp_path]
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    with open_scene(scene) as opened:
        manifest = opened.manifest
        assert found["frames"] == [1, len(opened), manifest.fps]
        assert found["cameras"] == list(manifest.names)
        np.testing.assert_allclose(found["scale"], manifest.metres_per_unit or 1, rtol=1e-6)
        assert found["counts"] == list(manifest.points[:16])
        for frame in (1, 9):
            picture = np.asarray(Image.open(tmp_path / f"{frame:02d}.png").convert("RGB")) / 255
            expected = opened.render(manifest.names[0], frame - 1).rgb
            assert -10 * np.log10(np.square(picture - expected).mean()) > MIN_PSNR
    assert found["memory_mb"][-1] - found["memory_mb"][0] < MAX_GROWTH_MB
    assert found["meshes"] == 1
    assert found["ply"] == [10, 20, 20]
    np.testing.assert_allclose(found["ply_up"], (0, 0, 2), atol=1e-6)
    expected_errors = (
        "nothing.4dv: expected a .4dv or .ply file, got none",
        "text.4dv: expected a .4dv scene",
        "bad.ply",
    )
    for error, text in zip(found["errors"], expected_errors, strict=True):
        assert text in error
        assert error.strip().count("\n") == 0
