"""Style files: presets, shade maps and user errors."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.cameras import Camera
from fourd.base.configs import load_overlay, to_yaml
from fourd.base.errors import UserError
from fourd.scene.styles import PRESETS, Style, load_style, view_style
from fourd.scene.styles.styles import DetailAxis, LineSettings, Ramp
from fourd.scene.styles.tables import make_table
from tests.baking.scenes import ring

CAMERA: Camera = ring(1, size=108)[0]


@pytest.mark.parametrize("name", PRESETS)
def test_presets_load_and_survive_a_round_trip(name: str, tmp_path: Path) -> None:
    """Catches a preset with a typo, and a style that cannot be saved."""
    style = load_style(name)
    (tmp_path / "copy.yaml").write_text(to_yaml(style))
    assert load_overlay(Style(), tmp_path / "copy.yaml") == style
    assert view_style(style, make_table(style), CAMERA, (0, 0, 0), (0, 0, 0)).numbers.pack().dtype == np.float32


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lines: {dept: 3}", "line 1: lines: expected a known key, got 'dept'; did you mean 'depth'?"),
        ("shading: tone", "shading: expected one of none, toon, xtoon, gooch, got 'tone'; did you mean 'toon'?"),
        ("lines: {depth: .nan}", "lines.depth: expected a number, got '.nan'"),
        ("lines:\n  normal: 0", "line 2: lines.normal: expected 1e-06 to 10, got 0"),
        ("lines: {thickness: .inf}", "lines.thickness: expected 0.25 to 8, got inf"),
        ("light: {direction: [0, 0, 0]}", "light.direction: expected a direction of length above 0"),
        ("ramp: {stops: [[0.5, 1, 1, 1]]}", "ramp.stops: expected 1 to 32 stops with rising tones, the first 0"),
        ("detail: {near: 2, far: 1}", "detail.far: expected more than near"),
        ("paper: [0, 0, 2]", "paper: expected 0 to 1, got 2"),
        ("persistence: 1", "persistence: expected 0 to 0.95, got 1"),
    ],
)
def test_mistakes_in_style_files_name_the_key(text: str, message: str, tmp_path: Path) -> None:
    """Catches a style file with a mistake that is drawn without an error."""
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        load_style(str(path))
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)


@pytest.mark.parametrize("values", [{"depth": float("nan")}, {"thickness": float("nan")}])
def test_thresholds_that_are_nan_are_refused(values: dict[str, float]) -> None:
    """Catches range checks that accept NaN."""
    with pytest.raises(ValueError, match=r"expected .* got nan"):
        LineSettings(**values)


def test_unknown_styles_name_the_nearest() -> None:
    """Catches a misspelled preset that is read as a file."""
    with pytest.raises(UserError, match=r"--style: expected toon, .* got 'goch'; did you mean gooch"):
        load_style("goch")
    with pytest.raises(UserError, match=r"missing.yaml: .*No such file"):
        load_style("missing.yaml")


def write_map(path: Path, rows: int, columns: int) -> None:
    cv2.imwrite(str(path), np.arange(rows * columns * 3, dtype=np.uint8).reshape(rows, columns, 3))


@pytest.mark.parametrize("shading", ["toon", "xtoon"])
def test_shade_maps_are_relative_to_the_style_file(shading: str, tmp_path: Path) -> None:
    """Catches a map that is searched in the working directory, and swapped channels."""
    rows = 1 if shading == "toon" else 3
    write_map(tmp_path / "map.png", rows, 4)
    (tmp_path / "mine.yaml").write_text(f"shading: {shading}\nramp: {{map: map.png}}")
    table = make_table(load_style(str(tmp_path / "mine.yaml")))
    assert table.shape == (rows, 256, 3)
    np.testing.assert_array_equal(table[0, [0, 63, 64, 255]], [[2, 1, 0], [2, 1, 0], [5, 4, 3], [11, 10, 9]])


@pytest.mark.parametrize(
    ("shading", "rows", "columns"), [("toon", 2, 8), ("xtoon", 65, 8), ("toon", 1, 1), ("toon", 1, 4097)]
)
def test_shade_maps_of_another_shape_are_refused(shading: str, rows: int, columns: int, tmp_path: Path) -> None:
    """Catches a map of a wrong size that is cut or scaled instead of refused."""
    write_map(tmp_path / "map.png", rows, columns)
    (tmp_path / "mine.yaml").write_text(f"shading: {shading}\nramp: {{map: map.png}}")
    with pytest.raises(UserError, match=rf"map.png: expected a PNG of .* got {columns} x {rows} pixels"):
        load_style(str(tmp_path / "mine.yaml"))


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_shade_maps_that_are_no_regular_files_are_refused(kind: str, tmp_path: Path) -> None:
    """Catches a shade map that is a named pipe, on which fourd would block forever, or a device with endless
    content.
    """
    path = tmp_path / "map.png"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    (tmp_path / "mine.yaml").write_text("shading: toon\nramp: {map: map.png}")
    with pytest.raises(UserError, match=r"map.png: expected a (file|PNG), got "):
        load_style(str(tmp_path / "mine.yaml"))


def test_damaged_shade_maps_are_refused(tmp_path: Path) -> None:
    """Catches a damaged file for which the decoder returns None and no error is reported."""
    (tmp_path / "mine.yaml").write_text("shading: toon\nramp: {map: map.png}")
    with pytest.raises(UserError, match=r"map.png: expected a PNG, got 'No such file"):
        load_style(str(tmp_path / "mine.yaml"))
    (tmp_path / "map.png").write_text("not a picture")
    with pytest.raises(UserError, match=r"map.png: expected a PNG .* got another file"):
        load_style(str(tmp_path / "mine.yaml"))
    write_map(tmp_path / "map.png", 1, 8)
    (tmp_path / "map.png").write_bytes((tmp_path / "map.png").read_bytes()[:40])
    with pytest.raises(UserError, match=r"map.png: expected a PNG, got a damaged file"):
        load_style(str(tmp_path / "mine.yaml"))


def test_stops_begin_at_their_tones() -> None:
    """Catches stops of the tone ramp that are shifted, and a softness that moves the stops."""
    ramp = Ramp(stops=((0.0, 0.0, 0.0, 0.0), (0.5, 1.0, 1.0, 1.0)), softness=0.0)
    table = make_table(Style(shading="toon", ramp=ramp))[0, :, 0]
    assert (table[:128] == 0).all()
    assert (table[128:] == 255).all()
    soft = make_table(Style(shading="toon", ramp=replace(ramp, softness=0.2)))[0, :, 0].astype(int)
    assert abs(soft[127] - 127) < 4
    assert soft[101] < 10
    assert soft[154] > 245
    assert (np.diff(soft) >= 0).all()


def test_details_fade_at_the_last_row() -> None:
    """Catches a fade at the wrong end. The fade ends at 1 for depth (far) and at 0 for facing (silhouettes)."""
    fade = DetailAxis(by="depth", fade=1.0, fade_colour=(0.0, 0.0, 0.0))
    assert (make_table(Style(shading="xtoon", detail=fade))[-1] == 0).all()
    assert (make_table(Style(shading="xtoon", detail=replace(fade, by="facing")))[0] == 0).all()


def test_lengths_scale_with_the_picture() -> None:
    """Catches lines that are relatively thinner in larger pictures, and a light in world axes that turns with the
    camera.
    """
    style = load_style("ink")
    for rows, thickness in ((108, 1), (1080, 2), (2160, 3), (1 << 14, 8)):
        camera = ring(1, size=rows)[0]
        assert view_style(style, make_table(style), camera, (0, 0, 0), (0, 0, 0)).thickness == thickness
    world = replace(style, light=replace(style.light, direction=(0.0, 0.0, 2.0), frame="world"))
    light = view_style(world, make_table(style), CAMERA, (0, 0, 0), (0, 0, 0)).numbers.light
    np.testing.assert_allclose(light, CAMERA.rotation[:, 2], atol=1e-6)
