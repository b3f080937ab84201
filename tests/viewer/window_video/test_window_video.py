"""The plan of a turntable, and the order of the cameras, of a scene that is open in the window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.viewer.display import DisplaySettings
from fourd.viewer.loaded_scene import LoadedScene
from fourd.viewer.session import Session
from fourd.viewer.window_video.rendering import plan_turntable
from tests.baking.scenes import manifest


class Source:
    """A scene whose frames are never read."""

    def __init__(self, frames: int, names: tuple[str, ...] = ("00", "01", "02", "03", "04", "05")) -> None:
        self.manifest = replace(manifest(6, frames), points=(1,) * frames, source_names=names)

    def read(self, index: int):
        raise AssertionError(index)

    def read_sound(self) -> None:
        return None

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("frames", "count"), [(5, 145), (100, 100), (1000, 1000)])
def test_a_turntable_has_no_jump(frames: int, count: int) -> None:
    """Catches a turn that does not end where it begins, a scene that jumps at the end, and a turn that is too fast."""
    session = Session(DisplaySettings(layers=1))
    scene = LoadedScene(Path("ball.4dv"), Source(frames))
    session.show(scene, scene.initial_pose((64, 48)))
    plan = plan_turntable(session, (64, 48))
    session.close()
    assert (len(plan.cameras), plan.fps) == (count, 24)
    assert list(plan.frames) == [index % frames for index in range(count)]
    steps = np.linalg.norm(np.diff([each.centre for each in (*plan.cameras, plan.cameras[0])], axis=0), axis=1)
    assert steps.max() < 1.01 * steps.min()


def test_cameras_are_in_the_order_of_their_names() -> None:
    """Catches a held-out camera that the user does not find among its neighbours."""
    scene = LoadedScene(Path("ball.4dv"), Source(1, ("1", "2", "10", "lamp 1", "z1", "z2")))
    scene.close()
    assert [scene.manifest.names[index] for index in scene.camera_order] == "1 2 10,held out,lamp 1,z1,z2".replace(
        " 2 10", ",2,10"
    ).split(",")
