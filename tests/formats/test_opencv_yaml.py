"""Tests of the reader of OpenCV's YAML: it returns the values that OpenCV has written, and raises an error for other
content.
"""

from __future__ import annotations

import string

import cv2
import numpy as np
import pytest

from fourd.base.formats.opencv_yaml import MAX_ITEMS, OpenCvYaml

HEADER = "%YAML:1.0\n---\n"


def write_with_opencv(names: list[str], values: dict[str, object], is_flow: bool) -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.startWriteStruct("names", cv2.FileNode_SEQ + (cv2.FileNode_FLOW if is_flow else 0))
    for name in names:
        storage.write("", name)
    storage.endWriteStruct()
    for key, value in values.items():
        storage.write(key, value)  # type: ignore[call-overload]
    return storage.releaseAndGetString()


def test_content_that_opencv_writes(rng: np.random.Generator) -> None:
    """Catches numbers, strings and matrices that are read with other values than OpenCV wrote."""
    letters = list(string.ascii_letters + string.digits + " \t\n\"\\'#:,[]{}-+.&*!|>%@?é")
    for _ in range(200):
        # OpenCV writes a string without quotes even if the string ends with a space or a quote, and then reads back
        # another string. Each name therefore ends with an underscore.
        names = ["".join(rng.choice(letters, rng.integers(30))) + "_" for _ in range(rng.integers(1, 40))]
        matrix = rng.choice([0.0, -1e-300, np.inf, -np.inf, 12345.0], rng.integers(1, 9, 2)) + rng.normal()
        wide = rng.normal(size=(2, 3, 4)).astype(np.float32)
        whole, real = int(rng.integers(-(1 << 31), 1 << 31)), float(rng.normal() * 10.0 ** rng.integers(-30, 30))
        values = {"K_a 1": matrix, "wide": wide, "W": whole, "real": real, "nan": np.nan}
        read = OpenCvYaml(write_with_opencv(names, values, bool(rng.integers(2))))
        assert read.items("names") == names
        assert np.array_equal(read.matrix("K_a 1"), matrix)  # type: ignore[arg-type]
        assert np.array_equal(np.float32(read.matrix("wide")), wide)  # type: ignore[arg-type]
        assert (read.number("W"), read.number("real")) == (whole, real)
        assert np.isnan(read.number("nan"))  # type: ignore[arg-type]


def test_content_that_other_programs_write() -> None:
    """Catches a reader that supports only OpenCV's own line breaks, or that parses values of other keys."""
    text = HEADER + (
        "# a comment: 1\n"
        "names: # of the cameras\r\n"
        '  - "00"\r\n'
        "  - cam#1 # a comment\n"
        "  - 'it''s'\n"
        "other: {a: [1, 2}\n"
        "deep:\n  a:\n    - b: 1\n"
        'K: !!opencv-matrix\n  rows: 1\n\n  cols: 2\n  dt: "d"\n  data: [1.,\n    # a comment\n    -.5e1]\n'
        "list: [ 1, +2.5 ]\n"
        "H: 720. # pixels\n"
        "...\n"
        "no entry\n"
    )
    read = OpenCvYaml(text)
    assert read.items("names") == ["00", "cam#1", "it's"]
    assert np.array_equal(read.matrix("K"), [[1, -5]])  # type: ignore[arg-type]
    assert np.array_equal(read.matrix("list"), [1, 2.5])  # type: ignore[arg-type]
    assert read.number("H") == 720
    assert "absent" not in read
    assert read.items("other") is read.items("deep") is read.matrix("names") is read.number("names") is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "another format"),
        ('{"a": 1}', "another format"),
        (HEADER + "a: 1\nb\n", r"'b' in line 4 instead of KEY: VALUE"),
        (HEADER + '- "00"\n', r"'- \"00\"' in line 3 instead of KEY: VALUE"),
        (HEADER + "\ta: 1\n", r"'\ta: 1' in line 3 instead of KEY: VALUE"),
        (HEADER + "a: 1\na: 2\n", r"'a: 2' in line 4 a second time"),
    ],
)
def test_other_formats_are_refused(text: str, message: str) -> None:
    """Catches an entry that is dropped or that replaces another one without an error."""
    with pytest.raises(ValueError, match=message):
        OpenCvYaml(text)


@pytest.mark.parametrize("values", ["[", "[1", "[1,", "[1,]", "[,1]", "[1] 2", "[[1]]", "[a: 1]", "- 1", "{}"])
def test_damaged_lists_have_no_items(values: str) -> None:
    """Catches a damaged list from which items are returned instead of None or an error."""
    assert OpenCvYaml(f"{HEADER}a: {values}\n").items("a") is None


def test_long_lists_are_refused() -> None:
    """Catches a list that takes much more memory than its file."""
    numbers = ",".join(["1"] * MAX_ITEMS)
    read = OpenCvYaml(f"{HEADER}a: [{numbers}]\nb: [{numbers},1]\nc:\n" + "  - 1\n" * (MAX_ITEMS + 1))
    assert read.items("a") == [1.0] * MAX_ITEMS
    assert read.items("b") is read.items("c") is None


@pytest.mark.parametrize(
    "change",
    [
        ("rows: 2\n", ""),
        ("cols: 1", "cols: -1"),
        ("2.]", '"2"]'),
        ("2.]", "2."),
        ("rows: 2", "rows: 2.5"),
        ("dt: d", "dt: 3d"),
    ],
)
def test_incomplete_matrices_are_refused(change: tuple[str, str]) -> None:
    """Catches a matrix whose shape differs from the declared shape. OpenCV's reader writes beyond the memory of such a
    matrix.
    """
    text = HEADER + "K: !!opencv-matrix\n  rows: 2\n  cols: 1\n  dt: d\n  data: [1., 2.]\n"
    assert np.array_equal(OpenCvYaml(text).matrix("K"), [[1], [2]])  # type: ignore[arg-type]
    assert change[0] in text
    with pytest.raises(ValueError, match="expected"):
        OpenCvYaml(text.replace(*change)).matrix("K")
