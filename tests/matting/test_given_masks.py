"""Masks from other programs, and images that the user paints."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.progress import untracked
from fourd.recording.capture import open_capture
from fourd.recording.matting import output, sequence
from fourd.recording.matting.motion.mattes import matting_cameras
from fourd.recording.matting.motion.paint import PAINTED_LOG_ODDS, Paint, parse_paint, read_strokes, strokes_in_frame
from fourd.recording.matting.output import SHEET, MatteState
from fourd.recording.matting.selection import Selection
from fourd.recording.matting.sequence import MATTES, MatteSettings, make_mattes, write_matte
from tests.matting.captures import matte_iou, write_capture_without_masks


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture without masks, and its true masks in truth/ beside it. Tests must not change this capture."""
    return write_capture_without_masks(tmp_path_factory.mktemp("given"), frames=5, size=64)


def test_masks_of_another_program_become_mattes(capture: Path, tmp_path: Path) -> None:
    """Catches masks of permuted cameras or frames, and a missing mask or a wrong size without its name."""
    own, masks = tmp_path / "capture", tmp_path / "masks"
    shutil.copytree(capture, own)
    shutil.copytree(capture.parent / "truth" / "masks", masks)
    settings = MatteSettings("masks", masks=masks)
    assert make_mattes(Selection(own), settings, 1, untracked) == 5
    for path in masks.glob("*/*.png"):
        made = cv2.imread(str(own / MATTES / path.parent.name / path.name), cv2.IMREAD_GRAYSCALE)
        assert np.array_equal(made, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    assert cv2.imwrite(str(masks / "03" / "000002.png"), np.zeros((9, 7), np.uint8))
    with pytest.raises(UserError, match=r"03/000002.png: expected 64 x 64 pixels like camera '03', got 7 x 9"):
        make_mattes(Selection(own), settings, 1, untracked)
    (masks / "03" / "000002.png").unlink()
    with pytest.raises(UserError, match=r"03/000002.png: expected a mask for each image of camera '03', got no such"):
        make_mattes(Selection(own), settings, 1, untracked)
    with pytest.raises(UserError, match=r"none: expected a folder with CAM/FRAME.png, got no such folder"):
        make_mattes(Selection(own), MatteSettings("masks", masks=tmp_path / "none"), 1, untracked)


def test_mattes_are_kept_if_another_method_fails(capture: Path, tmp_path: Path) -> None:
    """Catches mattes, which the user may have edited, that are deleted before the network of another method is read."""
    own = tmp_path / "capture"
    shutil.copytree(capture, own, copy_function=shutil.copy2)
    settings = MatteSettings("masks", masks=capture.parent / "truth" / "masks")
    assert make_mattes(Selection(own), settings, 1, untracked) == 5
    before = {path: path.read_bytes() for path in (own / MATTES).glob("*/*")}
    for failing in (MatteSettings("rvm"), MatteSettings("onnx")):
        with pytest.raises(UserError, match="expected a network file"):
            make_mattes(Selection(own), failing, 1, untracked)
    assert {path: path.read_bytes() for path in (own / MATTES).glob("*/*")} == before
    assert make_mattes(Selection(own), settings, 1, untracked) == 0


def test_mattes_are_kept_until_new_ones_are_complete(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches old mattes that are deleted before all new masks are read, and new mattes that are mixed with old mattes.
    Also catches finished new mattes that the next call writes again.
    """
    own, masks = tmp_path / "capture", tmp_path / "masks"
    shutil.copytree(capture, own, copy_function=shutil.copy2)
    truth = capture.parent / "truth" / "masks"
    settings = MatteSettings("masks", masks=truth)
    make_mattes(Selection(own), settings, 1, untracked)
    before = {path: path.read_bytes() for path in (own / MATTES).glob("*/*")}
    for path in truth.glob("*/*.png"):
        (masks / path.parent.name).mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(masks / path.parent.name / path.name), np.full((64, 64), 90, np.uint8))
    last = masks / "07" / "000004.png"
    for wrong in (cv2.imencode(".png", np.zeros((9, 7), np.uint8))[1].tobytes(), b"damaged"):
        last.write_bytes(wrong)
        with pytest.raises(UserError, match=r"07/000004.png"):
            make_mattes(Selection(own), MatteSettings("masks", masks=masks), 1, untracked)
        assert {path: path.read_bytes() for path in (own / MATTES).glob("*/*")} == before
        assert make_mattes(Selection(own), settings, 1, untracked) == 0
    assert cv2.imwrite(str(last), np.full((64, 64), 90, np.uint8))
    (own / SHEET).write_bytes(b"of the old mattes")
    with monkeypatch.context() as patch:
        patch.setattr(sequence, "write_matte", _fail_after(30))
        with pytest.raises(KeyboardInterrupt):
            make_mattes(Selection(own), MatteSettings("masks", masks=masks), 1, untracked)
    assert {path: path.read_bytes() for path in (own / MATTES).glob("*/*")} == before
    finished = {path.name: path.stat().st_mtime_ns for path in (own / ".fourd" / "new_mattes" / "02").iterdir()}
    assert make_mattes(Selection(own), MatteSettings("masks", masks=masks), 1, untracked) == 5
    assert {path.name: path.stat().st_mtime_ns for path in (own / MATTES / "02").iterdir()} == finished
    assert {(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) == 255).all() for path in (own / MATTES).glob("*/*")} == {True}
    assert sorted(path.name for path in (own / ".fourd").iterdir()) == ["mattes", "mattes.json"]


def _fail_after(count: int) -> Callable[[Path, np.ndarray], None]:
    """A replacement of write_matte that is interrupted after ``count`` files."""
    written = iter(range(count))

    def write(path: Path, matte: np.ndarray) -> None:
        if next(written, None) is None:
            raise KeyboardInterrupt
        write_matte(path, matte)

    return write


@pytest.mark.parametrize("at", range(1, 9))
def test_a_killed_exchange_of_mattes_loses_nothing(
    at: int, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command is killed between two steps of the exchange of old and new mattes. Catches a next call that keeps
    mattes of other settings, or that makes finished mattes again.
    """
    own = tmp_path / "capture"
    shutil.copytree(capture, own, copy_function=shutil.copy2)
    truth = capture.parent / "truth" / "masks"
    make_mattes(Selection(own), MatteSettings("masks", masks=truth), 1, untracked)
    expected = {path.name: path.read_bytes() for path in (own / MATTES / "00").iterdir()}
    make_mattes(Selection(own), MatteSettings("chroma", screen="0,255,0"), 1, untracked)
    made = list[str]()

    def stop(step: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any, **named: Any) -> Any:
            made.append(step)
            if len(made) == at:
                raise KeyboardInterrupt
            return function(*arguments, **named)

        return wrapped

    with monkeypatch.context() as patch:
        patch.setattr(MatteState, "write", stop("write", MatteState.write))
        patch.setattr(Path, "rename", stop("rename", Path.rename))
        patch.setattr(output.shutil, "rmtree", stop("rmtree", shutil.rmtree))
        with suppress(KeyboardInterrupt):
            make_mattes(Selection(own), MatteSettings("masks", masks=truth), 1, untracked)
    assert len(made) == at
    again = make_mattes(Selection(own), MatteSettings("masks", masks=truth), 1, untracked)
    assert again == 0 or "rename" not in made, made
    assert {path.name: path.read_bytes() for path in (own / MATTES / "00").iterdir()} == expected
    assert sorted(path.name for path in (own / ".fourd").iterdir()) == ["mattes", "mattes.json"]
    assert MatteState.read(own).new is None


def test_a_damaged_state_is_not_believed(capture: Path, tmp_path: Path) -> None:
    """Catches a traceback, or a text that is used as a method, for a state file with other content."""
    own = tmp_path / "capture"
    (own / ".fourd").mkdir(parents=True)
    for content in ("[]", "{", '{"chosen": "\\u001b[31m", "key": 5}', '{"chosen": ["masks"]}'):
        (own / ".fourd" / "mattes.json").write_text(content)
        assert MatteState.read(own) == MatteState()


@pytest.mark.parametrize("text", ["cam02", "cam02=mask.png", "cam02:x=mask.png", ":4=mask.png", "cam02:4="])
def test_paint_needs_camera_frame_and_file(text: str) -> None:
    """Catches a painted image that is ignored because of a misspelt option."""
    with pytest.raises(UserError, match=r"--paint: expected CAM:FRAME=FILE.png, such as cam02:40=mask.png"):
        parse_paint(text)


def test_wrong_painted_images_are_one_line(capture: Path, tmp_path: Path) -> None:
    """Catches a traceback, or learning that starts before the painted images are checked."""
    path = tmp_path / "mask.png"
    assert cv2.imwrite(str(path), np.full((64, 64), 128, np.uint8))

    def message(camera: str, frame: int) -> str:
        with pytest.raises(UserError) as caught:
            make_mattes(Selection(capture), MatteSettings(paint=(Paint(camera, frame, path),)), 1, untracked)
        return str(caught.value)

    assert "--paint: expected camera names among 00, 01" in message("cam9", 0)
    assert "--paint 02:5: expected a frame from 0 to 4, got 5" in message("02", 5)
    assert "mask.png: expected white or black strokes, got only grey" in message("02", 0)
    assert cv2.imwrite(str(path), np.zeros((9, 7), np.uint8))
    assert "mask.png: expected 64 x 64 pixels like camera '02', got 7 x 9" in message("02", 0)


def test_strokes_are_carried_to_neighbouring_frames(capture: Path, tmp_path: Path) -> None:
    """Catches strokes of the wrong sign, transparent pixels that count as black, and strokes in other cameras. Also
    catches strokes that stay where they were painted although the subject moves."""
    opened = open_capture(capture)
    cameras = matting_cameras(opened)
    picture = np.zeros((64, 64, 4), np.uint8)
    true = cv2.imread(str(capture.parent / "truth" / "masks" / "02" / "000001.png"), cv2.IMREAD_GRAYSCALE) > 127
    inner = cv2.erode(true.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    picture[inner] = 255
    picture[:4] = (0, 0, 0, 255)
    assert cv2.imwrite(str(tmp_path / "strokes.png"), picture)
    strokes = read_strokes([Paint("02", 1, tmp_path / "strokes.png")], opened, cameras)
    here = strokes_in_frame(strokes, opened, cameras, 1)
    assert [index for index, odds in enumerate(here) if odds is not None] == [2]
    odds = here[2]
    assert odds is not None
    assert (odds[inner] == PAINTED_LOG_ODDS).all()
    assert (odds[:4] == -PAINTED_LOG_ODDS).all()
    assert (odds[4:][~inner[4:]] == 0).all()
    carried = strokes_in_frame(strokes, opened, cameras, 2)[2]
    assert carried is not None
    later = cv2.imread(str(capture.parent / "truth" / "masks" / "02" / "000002.png"), cv2.IMREAD_GRAYSCALE) > 127
    assert 0 < carried.max() < PAINTED_LOG_ODDS
    assert later[carried > 0].mean() > 0.97


def test_a_painted_mask_changes_its_frame(capture: Path, tmp_path: Path) -> None:
    """Catches painted strokes that have no effect because the hull or the smoothing changes them. Also catches models
    that are learned again for new strokes."""
    own = tmp_path / "capture"
    shutil.copytree(capture, own)
    shutil.copytree(capture.parent / "truth", tmp_path / "truth")
    make_mattes(Selection(own), MatteSettings(), 1, untracked)
    model = (own / ".fourd" / "subject.npz").stat().st_mtime_ns
    before = matte_iou(open_capture(own), tmp_path / "truth")
    mask = tmp_path / "truth" / "masks" / "04" / "000003.png"
    settings = MatteSettings(paint=(Paint("04", 3, mask),))
    assert make_mattes(Selection(own), settings, 1, untracked) == 5
    assert (own / ".fourd" / "subject.npz").stat().st_mtime_ns == model
    after = matte_iou(open_capture(own), tmp_path / "truth")
    assert after[4, 3] > 0.95
    assert after.mean() > before.mean() - 0.002
    # The mattes are nearly perfect without strokes, so only a wrong painted mask can show that strokes have an effect.
    # The intersection over union of the painted and the true mask is 0.59. Edge refinement moves the painted edges back
    # a little.
    moved = np.roll(cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE), 6, axis=1)
    assert cv2.imwrite(str(tmp_path / "moved.png"), moved)
    make_mattes(Selection(own), MatteSettings(paint=(Paint("04", 3, tmp_path / "moved.png"),)), 1, untracked)
    made = cv2.imread(str(own / ".fourd" / "mattes" / "04" / "000003.png"), cv2.IMREAD_GRAYSCALE) > 127
    painted = moved > 127
    assert (made & painted).sum() > 0.7 * (made | painted).sum()
