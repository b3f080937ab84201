"""Points of frames: storage, selection of visible points, and the constraint to silhouettes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.frame_store import FrameStore
from fourd.reconstruction.training.points.scratch import Scratch
from fourd.reconstruction.training.points.silhouette import revert_moves_out_of_silhouettes
from fourd.reconstruction.training.rendering import COUNT_STEP, select_heaviest


def fresh_points(xyz: torch.Tensor, spacing: float, explicit_sh: bool = False) -> FramePoints:
    return FramePoints.initial(xyz, torch.full((len(xyz),), spacing), 1.0, explicit_sh=explicit_sh)


def fresh(count: int = 6, seed: int = 0) -> FramePoints:
    return fresh_points(torch.rand(count, 3, generator=torch.Generator().manual_seed(seed)), 0.01)


def test_tensors_round_trip() -> None:
    points = fresh_points(torch.rand(4, 3), 0.01, explicit_sh=True)
    again = FramePoints.from_tensors(points.tensors())
    assert set(again.parameters) == {"xyz", "sh"}
    assert torch.equal(again.optimizer.moments["sh"], points.optimizer.moments["sh"])


def test_changes_survive_eviction_from_the_cache(tmp_path: Path) -> None:
    """Catches changes that are lost when a frame is evicted from memory, and a cache that keeps every frame."""
    store = FrameStore(Scratch(tmp_path / "scratch"), 20, lambda frame: fresh(20_000, frame), 2, None)
    for frame in range(20):
        store.get(frame).xyz[0] = frame
    assert store.cached_count <= 2
    assert [float(store.get(frame).xyz[0, 0]) for frame in range(20)] == list(range(20))


def test_a_saved_store_is_a_snapshot(tmp_path: Path) -> None:
    """Catches points in a saved folder that change when the points in memory change later."""
    store = FrameStore(Scratch(tmp_path / "scratch"), 3, lambda frame: fresh(10, frame), 16, None)
    store.get(1).xyz[0] = 7
    store.save(tmp_path / "saved")
    store.get(1).xyz[0] = 8
    again = FrameStore(Scratch(tmp_path / "other"), 3, lambda frame: fresh(10, frame), 16, tmp_path / "saved")
    assert float(again.get(1).xyz[0, 0]) == 7
    assert torch.equal(again.get(2).xyz, fresh(10, 2).xyz)


def test_saving_copies_the_newest_file_of_an_evicted_frame(tmp_path: Path) -> None:
    """Catches a checkpoint with outdated or untrained points for frames that are not in memory."""
    store = FrameStore(Scratch(tmp_path / "scratch"), 6, lambda frame: fresh(20_000, frame), 1, None)
    for turn in (1, 2):
        for frame in range(5):
            store.get(frame).xyz[0] = 10 * turn + frame
        store.save(tmp_path / f"saved{turn}")
    assert store.cached_count == 1
    again = FrameStore(Scratch(tmp_path / "other"), 6, lambda frame: fresh(20_000, frame), 1, tmp_path / "saved2")
    assert [float(again.get(frame).xyz[0, 0]) for frame in range(5)] == [20, 21, 22, 23, 24]
    assert torch.equal(again.get(5).xyz, fresh(20_000, 5).xyz), "never trained"


def test_numbers_of_visible_points_are_rounded_up() -> None:
    """Catches a visible point that is not selected, and a selected hidden point that has less weight than an unselected
    point."""
    weight = torch.rand(3 * COUNT_STEP + 5, generator=torch.Generator().manual_seed(1))
    rows = select_heaviest(weight, 0.5)
    assert rows.tolist() == sorted(set(rows.tolist()))
    assert len(rows) == -(-int((weight > 0.5).sum()) // COUNT_STEP) * COUNT_STEP
    unselected = torch.ones_like(weight, dtype=torch.bool).index_fill(0, rows, False)
    assert float(weight[unselected].max()) <= min(0.5, float(weight[rows].min()))
    assert len(select_heaviest(weight, 0.0)) == len(weight), "never more than the number of points"


def test_points_do_not_leave_a_silhouette() -> None:
    """Catches points that leave the object, and points that cannot move because they were already outside the matte."""
    camera = Camera(np.array([[20.0, 0, 10], [0, 20, 10], [0, 0, 1]]), np.eye(3), np.zeros(3), 20, 20)
    matte = torch.zeros(20, 20)
    matte[5:15, 5:15] = 1
    before = torch.tensor([[0.0, 0, 1], [0.0, 0, 1], [-0.45, 0, 1], [0.2, 0, 1], [0.0, 0, 1]])
    moved = torch.tensor([[0.1, 0, 1], [0.4, 0, 1], [-0.4, 0, 1], [5.0, 0, 1], [0.0, 0, -1]])
    points = fresh_points(torch.zeros(9, 3), 0.1)
    rows = torch.tensor([1, 3, 4, 6, 8])
    points.parameters["xyz"][rows] = moved
    revert_moves_out_of_silhouettes(points, rows, before, [((camera,), matte[None])])
    got = points.xyz[rows]
    assert torch.equal(got[0], moved[0]), "a move within the silhouette"
    assert torch.equal(got[1], before[1]), "a move out of it"
    assert torch.equal(got[2], moved[2]), "outside before and after"
    assert torch.equal(got[3], moved[3]), "a move out of the image, where the matte is unknown"
    assert torch.equal(got[4], moved[4]), "a move behind the camera"


def test_prepared_points_are_those_that_were_evicted(tmp_path: Path) -> None:
    """Catches points that are read before the thread has written them, and prepared points of another frame."""
    store = FrameStore(Scratch(tmp_path / "scratch"), 4, lambda frame: fresh(20_000, frame), 1, None)
    for turn in range(1, 4):
        for frame in range(4):
            store.get(frame).xyz[0] = 10 * turn + frame
            store.prepare((frame + turn) % 4)
    assert store.cached_count == 1
    store.prepare(2)
    store.save(tmp_path / "saved")
    assert [float(store.get(frame).xyz[0, 0]) for frame in range(4)] == [30, 31, 32, 33]
    again = FrameStore(Scratch(tmp_path / "other"), 4, lambda frame: fresh(20_000, frame), 1, tmp_path / "saved")
    again.prepare(3)
    assert float(again.get(3).xyz[0, 0]) == 33
    again.close()


def test_evicted_points_that_cannot_be_written_end_training(tmp_path: Path) -> None:
    """Catches an error of the thread that nobody sees: the frame's training would be lost."""
    scratch = Scratch(tmp_path / "scratch")
    store = FrameStore(scratch, 3, lambda frame: fresh(20_000, frame), 1, None)
    store.get(0)
    scratch.folder.rmdir()
    store.get(1)
    with pytest.raises(UserError, match="expected free disk space for the points that do not fit in memory"):
        store.save(tmp_path / "saved")
