"""The public names of the package, for programs that use fourd as a library."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fourd
from tests.baking.scenes import write_scene
from tests.captures import write_ball_capture

PUBLIC = {
    *("Camera", "MatteSettings", "Player", "TrainConfig", "UserError"),
    *("look_at", "make", "open_capture", "open_run", "open_scene", "orbit", "render_points", "show", "spiral", "train"),
}
HEAVY = ("torch", "cv2", "numpy", "scipy", "av", "moderngl", "fourd._native")
SMALL = fourd.TrainConfig(max_steps=2, points=300, layers=4)


def test_the_public_names_are_these() -> None:
    """Catches a public name that is added, removed or moved without a decision."""
    assert set(fourd.__all__) == {*PUBLIC, "__version__"}
    assert set(dir(fourd)) >= PUBLIC
    assert all(getattr(fourd, name).__doc__ for name in PUBLIC)
    with pytest.raises(AttributeError, match="nothing"):
        _ = fourd.nothing


def test_importing_the_package_loads_nothing_heavy() -> None:
    """Catches an import of the package, or of what draws scenes, that loads torch or native modules."""
    code = f"import sys, fourd; print([name for name in {HEAVY} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
    code = "import sys, fourd; fourd.open_scene, fourd.Player, fourd.Camera; print('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_a_scene_describes_itself_and_iterates_over_its_frames(tmp_path: Path) -> None:
    """Catches a scene that prints as an address, skips frames, or renders from another camera than the named one."""
    frames = write_scene(tmp_path / "scene.4dv", frames=3)
    with fourd.open_scene(tmp_path / "scene.4dv") as scene:
        assert "scene.4dv: kind object, 3 frames at" in repr(scene)
        assert [frame.point_count for frame in scene] == [frame.point_count for frame in frames]
        name = scene.manifest.names[2]
        named, given = scene.render(name), scene.render(scene.manifest.cameras[2], 0)
        assert np.array_equal(named.rgb, given.rgb)
        with pytest.raises(ValueError, match=f"camera: expected one of the names .*{name}.*, got 'nobody'"):
            scene.render("nobody")
        path = fourd.orbit(scene.manifest.cameras, 4, size=(32, 24))
        assert [(camera.width, camera.height) for camera in path] == [(32, 24)] * 4


def test_train_and_make_as_functions(tmp_path: Path) -> None:
    """Catches functions that return before training, ignore the config, or print although they are asked not to."""
    capture = write_ball_capture(tmp_path / "capture", cameras=6, frames=2, size=64)
    run = fourd.train(capture, tmp_path / "run", SMALL, quiet=True)
    assert run.config.train.max_steps == 2
    assert (tmp_path / "run" / "checkpoints").is_dir()
    with pytest.raises(fourd.UserError, match="expected a new folder, got a run"):
        fourd.train(capture, tmp_path / "run", SMALL, quiet=True)
    seen: list[int] = []
    fourd.make(capture, tmp_path / "scene.4dv", SMALL, quiet=True, on_step=lambda now: seen.append(now.steps))
    assert seen == [1, 2]
    with fourd.open_scene(tmp_path / "scene.4dv") as scene:
        assert scene.manifest.frame_count == 2
        camera = fourd.open_capture(capture).cameras[0]
        picture = fourd.Player().draw(scene.frame(0), camera, scene.manifest)
    assert np.asarray(picture).max() > 0
