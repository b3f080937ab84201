"""Mattes of captures with held-out cameras, whose images must not influence anything that is trained."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from fourd.cli.main import main
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.mattes import MatteFiles, MatteSettings, MatteStageSettings, run_mattes
from fourd.recording.capture import open_capture
from fourd.recording.capture.split import write_test_views
from tests.matting.captures import matte_iou, write_capture_without_masks


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture whose test split holds out its second camera."""
    path = write_capture_without_masks(tmp_path_factory.mktemp("held_out") / "capture", frames=6, cameras=9)
    with open_capture(path, mattes=False) as opened:
        name = opened.names[1]
    write_test_views(path, [name])
    return path


def contents(capture: Path) -> dict[str, bytes]:
    folder = capture / ".fourd" / "mattes"
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.glob("*/*.png"))}


def test_held_out_images_influence_no_matte(
    capture: Path, tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches held-out images that shape the mattes of training cameras, and held-out cameras without mattes."""
    noisy = Path(shutil.copytree(capture, tmp_path / "noisy"))
    with open_capture(noisy, mattes=False) as opened:
        held_out = opened.names[1]
    for path in (noisy / "images" / held_out).glob("*"):
        picture = cv2.imread(str(path))
        cv2.imwrite(str(path), rng.integers(0, 256, picture.shape, np.uint8))
    for path in (capture, noisy):
        assert main(["matte", str(path), "--workers", "1"]) == 0
    assert contents(capture) == contents(noisy)
    assert f"the mattes of the held-out cameras {held_out} are the silhouettes" in " ".join(
        capsys.readouterr().err.split()
    )
    with open_capture(capture) as opened:
        found = matte_iou(opened, capture.parent / "truth")
        assert found.mean() > 0.8, found.round(2)
        assert found[opened.names.index(held_out)].min() > 0.7, found.round(2)
    assert not any((capture / ".fourd" / "plates").glob(f"{held_out}*"))


def test_few_cameras_are_not_separated(tmp_path: Path) -> None:
    """Catches held-out views that are scored with silhouettes of a few cameras, which cover half of the room."""
    few = write_capture_without_masks(tmp_path / "few", frames=2, cameras=8)
    with open_capture(few, mattes=False) as opened:
        names = opened.names
    assert MatteStageSettings(None, None, MatteSettings(), names[:1]).split(few) == (None, ())
    assert MatteStageSettings(None, None, MatteSettings("chroma"), names[:1]).split(few) == (None, ())
    text = io.StringIO()
    context = Context(Console(file=text, width=300))
    run_mattes(MatteFiles(few), MatteStageSettings(names[:4], "0:1", MatteSettings(), names[:1]), context)
    assert f"with the held-out images of {names[0]}: silhouettes of the hull of fewer than 8" in text.getvalue()
    assert (few / ".fourd" / "mattes" / names[0]).is_dir()
