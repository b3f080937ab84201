"""Playing scenes without torch, so that a viewer does not need torch installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.baking.scenes import write_full_scene

PROGRAM = """
import sys

import fourd
import fourd.rendering
from fourd.scene import open_scene
from fourd.scene.depth_order import DepthSorter
from fourd.scene.player import Player

with open_scene(sys.argv[1]) as scene:
    camera, frame = scene.manifest.cameras[0], scene.frame(0)
    assert scene.render(camera, 0).alpha.max() > 0
    assert Player().draw(frame, camera, scene.manifest).max() > 0
    assert len(DepthSorter().sort(frame, camera, scene.manifest.near)) > 0
assert "torch" not in sys.modules, "torch was imported"
"""


def test_importing_and_playing_load_no_torch(tmp_path: Path) -> None:
    """Catches an import of torch in any module that is needed to play a scene."""
    write_full_scene(tmp_path / "scene.4dv")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path / "scene.4dv")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
