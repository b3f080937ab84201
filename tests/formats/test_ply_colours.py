"""Colours of PLY files in the names, types and ranges of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.formats.ply import read_ply

WORDS = {
    "u1": "uchar",
    "i1": "char",
    "u2": "ushort",
    "i2": "short",
    "u4": "uint",
    "i4": "int",
    "f4": "float",
    "f8": "double",
}
RGB = np.array([[100, 1, 1], [0, 255, 7], [30, 60, 254]])


def write(
    path: Path, values: object, code: str, names: str = "red green blue", order: str = "<", **more: object
) -> Path:
    """Write three points with colours of one type, in the byte order "<" or ">" or as text ("a"). ``more`` are further
    uchar properties."""
    colours = np.asarray(values, np.float64)
    columns = [(axis, "f4", np.arange(len(colours)) * 0.5) for axis in "xyz"]
    columns += [(name, code, colours[:, k]) for k, name in enumerate(names.split())]
    columns += [(name, "u1", np.asarray(column)) for name, column in more.items()]
    kind = {"<": "binary_little_endian", ">": "binary_big_endian", "a": "ascii"}[order]
    header = ["ply", f"format {kind} 1.0", f"element vertex {len(colours)}"]
    header += [f"property {WORDS[type_]} {name}" for name, type_, _ in columns] + ["end_header", ""]
    if order == "a":
        body = "".join(
            " ".join(f"{column[row]:.9g}" for _, _, column in columns) + "\n" for row in range(len(colours))
        ).encode()
    else:
        rows = np.zeros(len(colours), [(name, order + type_) for name, type_, _ in columns])
        for name, _, column in columns:
            rows[name] = column
        body = rows.tobytes()
    path.write_bytes("\n".join(header).encode() + body)
    return path


@pytest.mark.parametrize("order", ["<", ">", "a"])
@pytest.mark.parametrize(
    ("code", "scale"),
    [
        *(("u1", 1), ("u2", 257), ("u2", 1), ("i2", 1), ("i4", 1), ("u4", 257)),
        *(("f4", 1), ("f8", 1), ("f4", 257), ("f4", 1 / 255), ("f8", 1 / 255)),
    ],
)
def test_colours_of_every_type_are_the_same(tmp_path: Path, order: str, code: str, scale: float) -> None:
    """Catches 16-bit colours and floats from 0 to 255 that become white, and text that loses its declared type."""
    found = read_ply(write(tmp_path / "a.ply", RGB * scale, code, order=order))
    assert found.rgb.tolist() == RGB.tolist()


@pytest.mark.parametrize("names", ["diffuse_red diffuse_green diffuse_blue", "r g b", "Red Green Blue", "R G B"])
def test_colours_of_every_name_are_found(tmp_path: Path, names: str) -> None:
    """Catches colours under another name that become grey."""
    assert read_ply(write(tmp_path / "a.ply", RGB, "u1", names)).rgb.tolist() == RGB.tolist()


def test_floats_slightly_above_one_are_clipped(tmp_path: Path) -> None:
    """Catches colours that are read as values from 0 to 255, that is as black, because one exceeds 1 by rounding."""
    found = read_ply(write(tmp_path / "a.ply", [[1.0001, 0.5, -0.01], [0.2, 1.3, 0]], "f4"))
    assert found.rgb.tolist() == [[255, 128, 0], [51, 255, 0]]
    dark = read_ply(write(tmp_path / "a.ply", [[3, 0, 1], [2, 4, 0]], "f4"))
    assert dark.rgb.tolist() == [[3, 0, 1], [2, 4, 0]]


def test_points_without_a_colour_are_grey(tmp_path: Path) -> None:
    """Catches NaN that becomes black, and an error for a file without colours or without points."""
    found = read_ply(write(tmp_path / "a.ply", [[np.nan, np.nan, np.nan], [0.2, 1, 0]], "f4"))
    assert found.rgb.tolist() == [[128] * 3, [51, 255, 0]]
    assert read_ply(write(tmp_path / "b.ply", RGB, "u1", "nx ny nz")).rgb.tolist() == [[128] * 3] * 3
    assert read_ply(write(tmp_path / "c.ply", np.zeros((0, 3)), "f4")).rgb.shape == (0, 3)


@pytest.mark.parametrize(
    ("values", "code", "names", "message"),
    [
        ([[5.5, 0, 0]], "f4", "red green blue", "got float numbers from 0 to 5.5 in red, green, blue; write the file"),
        ([[1e6, 0, 0]], "f4", "red green blue", "expected colours of 8 or 16 bits, or floats from 0 to 1 or from 0 to"),
        ([[np.inf, 0, 0]], "f4", "red green blue", "got float numbers from 0 to inf"),
        ([[-1, 1, 0.2]], "f4", "red green blue", "got float numbers from -1 to 1"),
        ([[70000, 1, 0]], "i4", "red green blue", "got whole numbers from 0 to 70000"),
        ([[300, 1, 0]], "i2", "red green blue", "got whole numbers from 0 to 300"),
        ([[-5, 100, 0]], "i1", "red green blue", "got whole numbers from -5 to 100"),
        (
            [[1, 2, 3]],
            "u1",
            "red green cyan",
            "expected colours as red, green and blue, or none, got the properties green",
        ),
        (
            [[1, 2, 3]],
            "u1",
            "specular_red specular_green specular_blue",
            "got the properties specular_blue, specular_gr",
        ),
        ([[1, 2, 3]], "u4", "rgb u v", "got the properties rgb; write the file again with uchar red, green and blue"),
    ],
)
@pytest.mark.parametrize("order", ["<", "a"])
def test_unclear_colours_are_refused(
    tmp_path: Path, values: object, code: str, names: str, message: str, order: str
) -> None:
    """Catches colours that are guessed, and colours that become grey without a message."""
    with pytest.raises(UserError, match=message) as caught:
        read_ply(write(tmp_path / "a.ply", values, code, names, order))
    assert str(caught.value).startswith(f"{tmp_path / 'a.ply'}: ")


def test_transparent_points_are_refused(tmp_path: Path) -> None:
    """Catches alpha that is dropped, and an error for points that are all opaque."""
    for alpha in ([255] * 3, [0] * 3):
        assert read_ply(write(tmp_path / "a.ply", RGB, "u1", alpha=alpha)).rgb.tolist() == RGB.tolist()
    with pytest.raises(
        UserError, match=r"a\.ply: expected opaque points, got alpha from 0 to 255; remove the transparent"
    ):
        read_ply(write(tmp_path / "a.ply", RGB, "u1", alpha=[255, 0, 255]))
