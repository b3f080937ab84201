"""Tests of the writer of OpenCV's YAML: OpenCV and fourd's reader read the same values, whatever the keys."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from fourd.base.formats.opencv_yaml import OpenCvYaml
from fourd.base.formats.opencv_yaml_writer import Value, escape_key, write_opencv_yaml

NAMES = ["00", "cam1", "a b", "1a", "it's", 'q"x', "_x", "左", "a-b", "é\\", "a#b", "a:b", "x, y", "[c]", "-", "1e5"]


def write_with_opencv(values: dict[str, Value]) -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for key, value in values.items():
        if isinstance(value, list):
            storage.startWriteStruct(key, cv2.FileNode_SEQ)
            for item in value:
                storage.write("", item)
            storage.endWriteStruct()
        else:
            storage.write(key, value)  # type: ignore[call-overload]
    return storage.releaseAndGetString()


def test_bytes_that_opencv_writes(rng: np.random.Generator) -> None:
    """Catches a file that differs from OpenCV's in numbers, quotes or line breaks, which other parsers may not read."""
    for _ in range(200):
        values: dict[str, Value] = {"names": [str(name) for name in rng.permutation(NAMES)[: rng.integers(1, 9)]]}
        for index in range(4):
            matrix = rng.normal(size=rng.integers(1, 9, 2)) * 10.0 ** rng.integers(-30, 30)
            matrix = np.where(rng.random(matrix.shape) < 0.3, rng.integers(-(1 << 33), 1 << 33), matrix)
            values |= {f"K_{index}": matrix, f"H_{index}": int(rng.integers(5000))}
        assert write_opencv_yaml(values) == write_with_opencv(values)


def test_keys_that_opencv_cannot_write(rng: np.random.Generator) -> None:
    """Catches a key that OpenCV or fourd cannot read, or that gives the value of another key."""
    characters = [*map(chr, range(32, 127)), "\xa0", "\x85", "é", "左", "\u0301", "\U0001f600"]
    names = [
        f"{head}{character}{tail}" for character in characters for head, tail in (("", "b"), ("a", ""), ("a", "b"))
    ]
    names += ["%3A", ":", "%", "%%3A", "%253A", "a%3", "%zz", "a  ", "true", "null", "x" * 250]
    names = list(dict.fromkeys(names))
    values: dict[str, Value] = {"names": names}
    values |= {escape_key(f"K_{name}"): rng.normal(size=(1, 2)) for name in names}
    assert len(values) == len(names) + 1
    text = write_opencv_yaml(values)
    opencv = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    own = OpenCvYaml(text)
    listed = opencv.getNode("names")
    assert own.strings("names") == [listed.at(index).string() for index in range(listed.size())] == names
    for name in names:
        key = escape_key(f"K_{name}")
        assert np.array_equal(own.matrix(key), values[key]), name  # type: ignore[arg-type]
        assert np.array_equal(opencv.getNode(key).mat(), values[key]), name


def test_numbers_to_the_last_bit(rng: np.random.Generator) -> None:
    """Catches a calibration that changes when it is read and written again."""
    bits = rng.integers(0, 1 << 64, 20_000, dtype=np.uint64).view(np.float64)
    numbers = np.concatenate(
        [bits[np.isfinite(bits)][:8000], [0.0, -0.0, 5e-324, -1.0, 1e15, 1e16, 2.0**31, -(2.0**31)]]
    )
    read = OpenCvYaml(write_opencv_yaml({"K": numbers[None]})).matrix("K")
    assert read is not None
    assert read.tobytes() == numbers.tobytes()
    with pytest.raises(ValueError, match="K: expected finite numbers, got"):
        write_opencv_yaml({"K": np.array([[np.nan]])})
    with pytest.raises(ValueError, match=r"without control characters, got 'a\\tb'"):
        write_opencv_yaml({"names": ["a\tb"]})
