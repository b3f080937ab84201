"""The programs in examples/triangles/, with small images and few steps."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.examples.programs import EXAMPLES, help_of, run_here

SHARED = ("common.py", "shapes.py")
PROGRAMS = sorted(f"triangles/{path.name}" for path in (EXAMPLES / "triangles").glob("*.py") if path.name not in SHARED)
CAPTURE = Path(__file__).parents[3] / "shared" / "captures" / "fox_run"


def test_help_describes_every_program() -> None:
    """Catches a program whose imports or flags no longer work."""
    assert [script for script, text in help_of(PROGRAMS).items() if "usage:" not in text] == []


def test_readme_lists_every_program() -> None:
    """Catches a program without an entry in examples/README.md."""
    text = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert [script for script in PROGRAMS if f"({script})" not in text] == []


def test_the_corners_of_the_cube_are_found(tmp_path: Path) -> None:
    """Catches a wrong sign of the gradient of silhouettes."""
    printed = run_here("triangles/cube.py", "--size", 16, "--steps", 120, "--picture", tmp_path / "cube.png")
    errors = [float(value) for value in re.findall(r"corner error (\S+) of", printed)]
    assert errors[-1] < 0.8 * errors[0]
    with Image.open(tmp_path / "cube.png") as picture:
        assert picture.size == (3 * 256, 256)


def test_mipmaps_help_the_globe(tmp_path: Path) -> None:
    """Catches mip levels that are ignored, or gradients that do not pass through the mip chain."""
    options = ("--steps", 25, "--texture-size", 64, "--size", 48, "--picture", tmp_path / "earth.png")
    printed = run_here("triangles/earth.py", *options)
    scores = dict(re.findall(r"^(\S+): PSNR of the texture (\S+) dB$", printed, flags=re.M))
    assert float(scores["linear-mipmap-linear"]) > float(scores["linear"])


def test_the_environment_map_is_found(tmp_path: Path) -> None:
    """Catches faces of the cube map that are exchanged or mirrored."""
    printed = run_here(
        "triangles/environment.py", "--steps", 50, "--size", 64, "--map-size", 8, "--picture", tmp_path / "map.png"
    )
    scores = [float(value) for value in re.findall(r"PSNR of the map (\S+) dB", printed)]
    assert scores[-1] > scores[0] + 4


def test_the_pose_search_reports_its_success(tmp_path: Path) -> None:
    """Catches a search that makes the pose worse than its start."""
    options = ("--starts", 2, "--steps", 60, "--size", 48, "--picture", tmp_path / "pose.png")
    printed = run_here("triangles/pose.py", *options)
    assert re.search(r"\d of 2 starts found the pose within 2 degrees", printed)


def test_the_soft_rectangle_reaches_its_target(tmp_path: Path) -> None:
    """Catches a soft rasterizer without gradients far from the edges."""
    printed = run_here(
        "triangles/soft_rectangle.py", "--steps", 250, "--size", 32, "--picture", tmp_path / "rectangle.png"
    )
    overlaps = [float(value) for value in re.findall(r"intersection over union (\S+)", printed)]
    assert overlaps[0] == 0
    assert overlaps[-1] > 0.8


def test_the_cameras_are_adjusted(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches rotations in the wrong direction, and an alignment that hides errors or adds errors."""
    options = ("--size", 64, "--steps", 150, "--seed", int(rng.integers(1000)))
    printed = run_here("triangles/bundle_adjustment.py", *options, "--picture", tmp_path / "cameras.png")
    found = re.search(r"rotation error of the cameras: (\S+) degrees before, (\S+) degrees after", printed)
    assert found is not None
    before, after = map(float, found.groups())
    assert before > 2
    assert after < 0.7 * before


def test_the_sphere_becomes_an_aeroplane(tmp_path: Path) -> None:
    """Catches a sphere that shrinks or folds instead of approaching the shape of the aeroplane."""
    options = ("--size", 32, "--views", 12, "--steps", 80, "--batch", 2, "--subdivisions", 2)
    printed = run_here("triangles/sphere_to_object.py", *options, "--picture", tmp_path / "aeroplane.png")
    overlaps = [float(value) for value in re.findall(r"intersection over union (\S+),", printed)]
    distances = [float(value) for value in re.findall(r"Chamfer distance (\S+) ", printed)]
    assert overlaps[1] > overlaps[0] + 0.1
    assert distances[1] < 0.6 * distances[0]


def test_the_ellipsoid_becomes_a_torus(tmp_path: Path) -> None:
    """Catches depths that pull the surface towards the camera, so that the hole of the torus stays closed."""
    options = ("--cells", 12, "--size", 32, "--views", 16, "--steps", 100)
    printed = run_here("triangles/marching_tetrahedra.py", *options, "--picture", tmp_path / "torus.png")
    overlaps = [float(value) for value in re.findall(r"intersection over union (\S+),", printed)]
    assert overlaps[1] > 0.85


@pytest.mark.skipif(not CAPTURE.is_dir(), reason=f"needs the capture {CAPTURE}")
def test_the_ellipsoid_becomes_a_fox(tmp_path: Path) -> None:
    """Catches mattes and cameras that are cropped differently."""
    options = ("--capture", CAPTURE, "--cells", 16, "--steps", 80, "--picture", tmp_path / "fox.png")
    printed = run_here("triangles/marching_tetrahedra.py", *options)
    overlaps = [float(value) for value in re.findall(r"intersection over union (\S+)", printed)]
    assert overlaps[1] > 0.8
