"""Scratch folders for several processes that use one run at the same time, and for processes that have ended."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import torch

from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.frame_store import FrameStore
from fourd.reconstruction.training.points.scratch import Scratch

KILLED = """
import os, signal, sys
from pathlib import Path
from fourd.reconstruction.training.points.scratch import Scratch
scratch = Scratch(Path(sys.argv[1]))
(scratch.folder / "points").write_text("left behind")
print(scratch.folder, flush=True)
if sys.argv[2] == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
sys.stdin.read()
"""


def points(value: float) -> FramePoints:
    return FramePoints.initial(torch.full((20_000, 3), value), torch.full((20_000,), 0.1), 1.0, explicit_sh=False)


def folders(parent: Path) -> list[Path]:
    return [path for path in parent.glob("*") if path.is_dir()]


def test_two_stores_of_one_run_do_not_read_each_others_frames(tmp_path: Path) -> None:
    """Catches a scratch folder that two processes share. ``fourd eval`` would then render frames that ``fourd export``
    wrote from another checkpoint."""
    stores = [FrameStore(Scratch(tmp_path), 5, lambda frame, run=run: points(run), 1, None) for run in (1.0, 2.0)]
    for frame in range(5):
        for run, store in enumerate(stores, 1):
            store.get(frame).xyz[0] = 10 * run + frame
    assert all(store.cached_count < 5 for store in stores), "frames were written to scratch"
    for run, store in enumerate(stores, 1):
        assert [float(store.get(frame).xyz[0, 0]) for frame in range(5)] == [10.0 * run + frame for frame in range(5)]
        assert [float(store.get(frame).xyz[1, 0]) for frame in range(5)] == [float(run)] * 5


def test_a_folder_goes_with_its_owner(tmp_path: Path) -> None:
    """Catches scratch folders that are not removed and fill the disk while a viewer reloads a run."""
    parent = tmp_path / "scratch"
    first, second = Scratch(parent), Scratch(parent)
    assert len({first.folder, second.folder}) == len(folders(parent)) == 2
    (first.folder / "points").write_text("")
    kept = second.folder
    del first
    assert folders(parent) == [kept]
    second.close()
    second.close()
    assert not parent.exists()


def test_leftovers_of_a_dead_process_are_removed_and_those_of_a_living_one_kept(tmp_path: Path) -> None:
    """Catches the deletion of frames of a running process, and frames of a killed process that are never deleted."""
    parent = tmp_path / "scratch"
    living = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(parent), "living"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert living.stdout is not None
    used = Path(living.stdout.readline().strip())
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, str(parent), "killed"], capture_output=True, text=True, check=False
    )
    left = Path(killed.stdout.strip())
    assert (left / "points").exists()
    own = Scratch(parent)
    assert not left.exists()
    assert (used / "points").read_text() == "left behind"
    living.communicate(timeout=60)
    assert living.returncode == 0
    assert not used.exists()
    assert folders(parent) == [own.folder]
