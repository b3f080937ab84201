"""Learning of the shadow that a moving ball casts on a floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fourd.reconstruction.training.run import load_run
from tests.training.shadowed import FRAMES, picture, shadowed_config, write_shadowed_capture
from tests.training.small import trained_run


def test_a_shadow_is_learnt_and_the_floor_keeps_its_plate_s_colours(tmp_path: Path) -> None:
    """Catches a shadow that is not learnt or appears in the wrong frame, and a floor that is dark in all frames."""
    capture = write_shadowed_capture(tmp_path / "capture")
    run = load_run(trained_run(capture, tmp_path / "run", shadowed_config(tmp_path / "seeds.ply", 160)).folder)
    index = run.run.test[0]
    camera = run.run.capture.cameras[index]
    alone, plate = run.renderer.render_background(camera, 15).rgb, picture(camera, None)[0]
    for frame in range(FRAMES):
        truth, matte = picture(camera, frame)
        unshadowed = np.abs(picture(camera, frame, shadow=False)[0] - truth).mean(axis=-1)
        dark = (unshadowed > 0.08) & (matte < 0.02)
        assert dark.sum() > 40
        shown = run.renderer.render(run.frames.get(frame), frame, camera, 15).rgb
        assert np.abs(shown - truth)[dark].mean() < 0.6 * unshadowed[dark].mean()
        assert np.abs(alone - plate)[dark].mean() < 0.03
