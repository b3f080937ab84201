"""Sites that are updated while a run trains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from fourd.scene import SceneReader
from fourd.viewer.publish.live import LiveSite
from fourd.viewer.publish.site import SCENE_NAME, is_site
from tests.training.small import SMALL, train, trained_run, with_steps


def test_a_site_follows_a_run(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a page that still shows the first checkpoint of a run after training has written a new one."""
    run = trained_run(ball_capture, tmp_path / "run")
    live = LiveSite(run.folder, tmp_path / "site", "light", Console(quiet=True))
    assert is_site(tmp_path / "site")
    before = _positions(tmp_path / "site")
    assert not live.update()
    train(run, with_steps(SMALL, 12))
    assert live.update()
    assert not np.array_equal(_positions(tmp_path / "site"), before)


def _positions(site: Path) -> np.ndarray:
    reader = SceneReader(site / SCENE_NAME)
    xyz = reader.read(0).xyz
    reader.close()
    return xyz
