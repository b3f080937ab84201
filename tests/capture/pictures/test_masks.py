"""Masks as many programs write them: palettes, alpha channels, labels, 1 and 16 bits, JPEG."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from fourd.base.errors import UserError
from fourd.recording.capture.pictures.masks import MaskFolder

SIDE = 48
Inside = np.ndarray


def disc(radius: float) -> Inside:
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    return x**2 + y**2 < radius**2


def palette(colours: list[int]) -> Callable[[Path, Inside, int], None]:
    def save(path: Path, inside: Inside, frame: int) -> None:
        image = Image.fromarray((inside * (1 + frame % 2)).astype(np.uint8), "P")
        image.putpalette(colours)
        image.save(path)

    return save


def save_alpha(path: Path, inside: Inside, frame: int) -> None:
    colours = np.random.default_rng(frame).integers(0, 255, (SIDE, SIDE, 3), np.uint8)
    Image.fromarray(np.dstack([colours, 255 * inside.astype(np.uint8)])).save(path)


def save_grey_alpha(path: Path, inside: Inside, frame: int) -> None:
    Image.merge("LA", [Image.new("L", (SIDE, SIDE), 20), Image.fromarray(255 * inside.astype(np.uint8))]).save(path)


def save_coloured_labels(path: Path, inside: Inside, frame: int) -> None:
    half = np.arange(SIDE) < SIDE // 2
    rgb = np.where((inside & half)[..., None], (64, 0, 0), np.where(inside[..., None], (0, 128, 128), 0))
    Image.fromarray(rgb.astype(np.uint8)).save(path)


def grey(value: int, dtype: type = np.uint8) -> Callable[[Path, Inside, int], None]:
    def save(path: Path, inside: Inside, frame: int) -> None:
        assert cv2.imwrite(str(path), np.where(inside, value, 0).astype(dtype))

    return save


def save_labels(path: Path, inside: Inside, frame: int) -> None:
    assert cv2.imwrite(str(path), (inside * (1 + frame % 3)).astype(np.uint8))


def save_labels_with_border(path: Path, inside: Inside, frame: int) -> None:
    values = (inside * 2).astype(np.uint8)
    values[inside & ~disc(9)] = 255
    assert cv2.imwrite(str(path), np.where(disc(11), inside * 2, values).astype(np.uint8))


def save_bits(path: Path, inside: Inside, frame: int) -> None:
    Image.fromarray(inside).save(path)


KINDS: dict[str, Callable[[Path, Inside, int], None]] = {
    "255": grey(255),
    "1": grey(1),
    "128": grey(128),
    "labels": save_labels,
    "labels and 255": save_labels_with_border,
    "16 bit": grey(65535, np.uint16),
    "1 in 16 bit": grey(1, np.uint16),
    "255 in 16 bit": grey(255, np.uint16),
    "instance number in 16 bit": grey(26001, np.uint16),
    "1 bit": save_bits,
    "palette": palette([0, 0, 0, 128, 0, 0, 0, 128, 0]),
    "palette without black": palette([120, 120, 120, 180, 120, 120, 6, 230, 230]),
    "palette of grey": palette([0, 0, 0, 255, 255, 255, 255, 255, 255]),
    "alpha": save_alpha,
    "grey and alpha": save_grey_alpha,
    "coloured labels": save_coloured_labels,
}


def write(folder: Path, save: Callable[[Path, Inside, int], None], name: str = "{:06d}.png") -> dict[Path, Inside]:
    """Six masks of two cameras: empty at first, then a disc that grows."""
    written = {}
    for camera in ("cam1", "cam2"):
        (folder / camera).mkdir(parents=True)
        for frame in range(6):
            inside = disc(0 if frame == 0 else 8 + 2 * frame)
            path = folder / camera / name.format(frame)
            save(path, inside, frame)
            written[path] = inside
    return written


@pytest.mark.parametrize("kind", KINDS)
def test_the_object_is_white(tmp_path: Path, kind: str) -> None:
    """Catches a mask whose brightness is taken although its palette, alpha channel or labels say what the object is,
    and a meaning that is decided for one mask alone."""
    masks = MaskFolder(tmp_path)
    for path, inside in write(tmp_path, KINDS[kind]).items():
        assert np.array_equal(masks.decode(path), np.where(inside, 255, 0)), path
    assert bool(masks.notes()) == (kind not in ("255", "16 bit", "255 in 16 bit", "1 bit", "palette of grey"))


def test_jpeg_masks_keep_their_values(tmp_path: Path) -> None:
    """Catches compression noise near black that counts as labels."""

    def save(path: Path, inside: Inside, frame: int) -> None:
        Image.fromarray(255 * inside.astype(np.uint8)).convert("RGB").save(path, quality=60)

    masks = MaskFolder(tmp_path)
    for path, inside in write(tmp_path, save, "{:06d}.jpg").items():
        assert np.abs(masks.decode(path).astype(int) - 255 * inside).mean() < 12
    assert not masks.notes()


def test_soft_mattes_are_not_changed(tmp_path: Path) -> None:
    """Catches a frame with faint values only that is taken for labels because they are few."""
    soft = cv2.GaussianBlur(255 * disc(12).astype(np.uint8), (0, 0), 3)

    def save(path: Path, inside: Inside, frame: int) -> None:
        assert cv2.imwrite(str(path), soft if frame != 2 else np.minimum(soft, 1))

    masks = MaskFolder(tmp_path)
    for path in write(tmp_path, save):
        expected = soft if path.stem != "000002" else np.minimum(soft, 1)
        assert np.array_equal(masks.decode(path), expected)


def test_an_object_at_the_edge_of_a_camera_is_not_a_label(tmp_path: Path) -> None:
    """Catches a camera that sees a faint sliver, decided without the masks of the other cameras."""
    write(tmp_path, lambda path, inside, frame: grey(255)(path, inside, frame))
    sliver = np.zeros((SIDE, SIDE), np.uint8)
    sliver[0, :3] = (7, 80, 30)
    for path in (tmp_path / "cam2").iterdir():
        assert cv2.imwrite(str(path), sliver)
    assert np.array_equal(MaskFolder(tmp_path).decode(tmp_path / "cam2" / "000003.png"), sliver)


def test_masks_without_white_are_refused(tmp_path: Path) -> None:
    """Catches a guess at the opacity of masks whose largest value is 100."""

    def save(path: Path, inside: Inside, frame: int) -> None:
        assert cv2.imwrite(str(path), cv2.GaussianBlur(100 * disc(16).astype(np.uint8), (0, 0), 3))

    first = next(iter(write(tmp_path, save)))
    with pytest.raises(UserError, match=r"cam1: expected masks whose white is 255, got values up to 100; export masks"):
        MaskFolder(tmp_path).decode(first)


def test_coloured_masks_without_black_are_refused(tmp_path: Path) -> None:
    def save(path: Path, inside: Inside, frame: int) -> None:
        Image.fromarray(np.where(inside[..., None], (255, 0, 0), (0, 255, 0)).astype(np.uint8)).save(path)

    first = next(iter(write(tmp_path, save)))
    with pytest.raises(UserError, match="expected masks with a black background, got coloured masks without black"):
        MaskFolder(tmp_path).decode(first)
