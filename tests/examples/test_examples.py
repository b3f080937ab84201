"""The programs in examples/, with small images and few steps."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from PIL import Image

from fourd.recording.capture import open_capture
from tests.baking.scenes import ring, write_scene
from tests.captures import write_ball_capture
from tests.examples.programs import EXAMPLES, help_of, run_here, run_python

WITHOUT_TORCH = """
import runpy, sys
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
assert "torch" not in sys.modules, "the example imported torch"
"""
PROGRAMS = sorted(path.name for path in EXAMPLES.glob("*.py"))


def test_help_describes_every_example() -> None:
    """Catches an example whose imports or flags no longer work."""
    assert [script for script, text in help_of(PROGRAMS).items() if "usage:" not in text] == []


def test_readme_lists_every_example() -> None:
    """Catches an example without an entry in examples/README.md."""
    text = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert [script for script in PROGRAMS if f"({script})" not in text] == []


def test_fitting_improves_the_picture(tmp_path: Path) -> None:
    """Catches a sign error or a missing gradient in the example's training loop."""
    out = tmp_path / "fitted.png"
    printed = run_here("fit_points_to_picture.py", "--size", 32, "--points", 400, "--steps", 60, "--out", out)
    scores = [float(line.split()[2]) for line in printed.splitlines() if line.startswith("step")]
    assert scores[-1] > scores[0] + 8
    with Image.open(out) as picture:
        assert picture.size == (64, 32)


def test_training_from_python(tmp_path: Path) -> None:
    """Catches settings that training ignores, and runs that the example overwrites."""
    capture = write_ball_capture(tmp_path / "capture", cameras=6, frames=2, size=64)
    arguments = ("--out", tmp_path / "runs", "--max-steps", 20, "--points", 200, 400)
    lines = run_here("train_with_settings.py", capture, *arguments).splitlines()
    found = [re.match(r"(\d+) points: \d+\.\d dB in views that training did not use", line) for line in lines]
    assert [match and match[1] for match in found] == ["200", "400"]


def test_a_scene_is_drawn_without_torch(tmp_path: Path) -> None:
    """Catches an import of torch in a module that is needed to play scenes, and a camera that does not see the
    scene."""
    write_scene(tmp_path / "scene.4dv")
    out = tmp_path / "view.png"
    options = ("--frame", 1, "--degrees", 30, "--out", out)
    printed = run_python("-c", WITHOUT_TORCH, EXAMPLES / "draw_scene.py", tmp_path / "scene.4dv", *options)
    assert "201 points" in printed
    with Image.open(out) as picture:
        assert np.asarray(picture)[..., 3].max() > 100


def test_a_custom_format_becomes_a_capture(tmp_path: Path) -> None:
    """Catches a change in the interface of importers, and axes that the example converts wrongly."""
    rig, cameras = [], dict(zip(("left", "right"), ring(2), strict=True))
    for name, camera in cameras.items():
        (tmp_path / "source" / name).mkdir(parents=True)
        Image.new("RGB", (camera.width, camera.height), "grey").save(tmp_path / "source" / name / "000000.png")
        entry = {
            "name": name,
            "width": camera.width,
            "height": camera.height,
            "focal_px": float(camera.intrinsics[0, 0]),
            "R_world_camera": (camera.rotation.T @ np.diag([1, -1, -1])).tolist(),
            "position_m": camera.centre.tolist(),
        }
        rig.append(entry)
    (tmp_path / "source" / "rig.json").write_text(json.dumps(rig))
    run_here("custom_importer.py", tmp_path / "source", tmp_path / "capture")
    capture = open_capture(tmp_path / "capture")
    assert capture.frame_count == 1
    for name, camera in zip(capture.names, capture.cameras, strict=True):
        np.testing.assert_allclose(camera.rotation, cameras[name].rotation, atol=1e-6)
        np.testing.assert_allclose(camera.translation, cameras[name].translation, atol=1e-6)
