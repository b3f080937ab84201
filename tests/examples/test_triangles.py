"""The programs in examples/triangles/, with small images and few steps."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

FOLDER = Path(__file__).parents[2] / "examples" / "triangles"
PROGRAMS = sorted(path.name for path in FOLDER.glob("*.py") if path.name != "common.py")


def run(script: str, *arguments: object) -> str:
    """Run a program in a separate process and return what it prints."""
    environment = {**os.environ, "PYTHONPATH": str(FOLDER.parents[1]), "COLUMNS": "120"}
    command = [sys.executable, str(FOLDER / script), *map(str, arguments)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("script", PROGRAMS)
def test_help_describes_every_program(script: str) -> None:
    """Catches a program whose imports or flags no longer work."""
    assert "usage:" in run(script, "--help")


def test_readme_lists_every_program() -> None:
    """Catches a program without an entry in examples/README.md."""
    text = (FOLDER.parent / "README.md").read_text(encoding="utf-8")
    assert [script for script in PROGRAMS if f"(triangles/{script})" not in text] == []


def test_the_corners_of_the_cube_are_found(tmp_path: Path) -> None:
    """Catches a wrong sign of the gradient of silhouettes."""
    printed = run("cube.py", "--size", 16, "--steps", 120, "--out", tmp_path / "cube.png")
    errors = [float(value) for value in re.findall(r"corner error (\S+) of", printed)]
    assert errors[-1] < 0.8 * errors[0]
    with Image.open(tmp_path / "cube.png") as picture:
        assert picture.size == (3 * 256, 256)


def test_mipmaps_help_the_globe(tmp_path: Path) -> None:
    """Catches mip levels that are ignored, or gradients that do not pass through the mip chain."""
    options = ("--steps", 25, "--texture-size", 64, "--size", 48, "--out", tmp_path / "earth.png")
    printed = run("earth.py", *options)
    scores = dict(re.findall(r"^(\S+): PSNR of the texture (\S+) dB$", printed, flags=re.M))
    assert float(scores["linear-mipmap-linear"]) > float(scores["linear"])


def test_the_environment_map_is_found(tmp_path: Path) -> None:
    """Catches faces of the cube map that are exchanged or mirrored."""
    printed = run("environment.py", "--steps", 50, "--size", 64, "--map-size", 8, "--out", tmp_path / "map.png")
    scores = [float(value) for value in re.findall(r"PSNR of the map (\S+) dB", printed)]
    assert scores[-1] > scores[0] + 4


def test_the_pose_search_reports_its_success(tmp_path: Path) -> None:
    """Catches a search that makes the pose worse than its start."""
    options = ("--starts", 2, "--steps", 60, "--size", 48, "--out", tmp_path / "pose.png")
    printed = run("pose.py", *options)
    assert re.search(r"\d of 2 starts found the pose within 2 degrees", printed)


def test_the_soft_rectangle_reaches_its_target(tmp_path: Path) -> None:
    """Catches a soft rasterizer without gradients far from the edges."""
    printed = run("soft_rectangle.py", "--steps", 250, "--size", 32, "--out", tmp_path / "rectangle.png")
    overlaps = [float(value) for value in re.findall(r"intersection over union (\S+)", printed)]
    assert overlaps[0] == 0
    assert overlaps[-1] > 0.8
