"""Reads sequences of PLY files with one coloured point per vertex, of which each file is a frame."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.viewer.blender.addon.points import Cloud, ImportProblem

MAX_HEADER = 1 << 16
MAX_POINTS = 1 << 26
SH_CONSTANT = 0.28209479177387814
SAMPLES = 512
RADIUS_PER_SPACING = 1.8
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}


def list_sequence(path: Path) -> list[Path]:
    """Return the PLY files of a folder, or of the folder of a file, ordered by the numbers in their names. Raises
    ImportProblem."""
    folder = path if path.is_dir() else path.parent
    try:
        found = [each for each in folder.iterdir() if each.suffix.lower() == ".ply" and each.is_file()]
    except OSError as error:
        raise ImportProblem(f"{folder}: expected a folder of PLY files, got none ({error.strerror})") from error
    if not found:
        raise ImportProblem(f"{folder}: expected a folder of PLY files, got none in it")
    return sorted(found, key=lambda each: ([int(digits) for digits in re.findall(r"\d+", each.stem)], each.name))


def read_ply(path: Path) -> Cloud:
    """Read the vertices of a PLY file.

    Colours are the properties red, green and blue, or the constant spherical harmonics f_dc_0 to f_dc_2. Without
    ``radius``, all radii are 1.8 times the median distance to the nearest neighbour. Without ``density``, it is 1.

    Raises:
        ImportProblem: if the file is damaged, or its vertices have no positions.
    """
    try:
        table = _read_table(path)
        names = table.dtype.names or ()
        if not {"x", "y", "z"} <= set(names):
            raise ValueError("the vertices have no x, y and z")
    except (OSError, ValueError, OverflowError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ImportProblem(f"{path}: expected a PLY file of points, got another or damaged one ({reason})") from error
    xyz = np.stack([table[axis].astype(np.float32) for axis in "xyz"], axis=1)
    if not np.isfinite(xyz).all():
        raise ImportProblem(f"{path}: expected finite positions, got NaN or infinity")
    ones = np.ones(len(xyz), np.float32)
    radius = table["radius"].astype(np.float32) if "radius" in names else RADIUS_PER_SPACING * spacing(xyz) * ones
    density = np.clip(table["density"].astype(np.float32), 0, 1) if "density" in names else ones
    return Cloud(xyz, np.nan_to_num(np.maximum(radius, 0)), np.nan_to_num(density), _colours(table, names))


def spacing(xyz: NDArray[np.float32]) -> float:
    """Return the median distance of at most 512 of the points to their nearest neighbour, 0 for a single point."""
    if len(xyz) < 2:
        return 0.0
    chosen = np.random.default_rng(0).choice(len(xyz), min(SAMPLES, len(xyz)), replace=False)
    nearest = []
    for index in chosen:
        distance = np.square(xyz - xyz[index]).sum(axis=1)
        distance[index] = np.inf
        nearest.append(float(distance.min()))
    return float(np.sqrt(np.median(nearest)))


def _colours(table: NDArray[np.void], names: tuple[str, ...]) -> NDArray[np.float32]:
    if {"red", "green", "blue"} <= set(names):
        channels = [table[name] for name in ("red", "green", "blue")]
        scale = 255 if channels[0].dtype.kind in "iu" else 1
        colour = np.stack([channel.astype(np.float32) / scale for channel in channels], axis=1)
    elif {"f_dc_0", "f_dc_1", "f_dc_2"} <= set(names):
        colour = np.stack([0.5 + SH_CONSTANT * table[f"f_dc_{index}"].astype(np.float32) for index in range(3)], axis=1)
    else:
        colour = np.full((len(table), 3), 0.7, np.float32)
    return np.nan_to_num(np.clip(colour, 0, 1))


def _read_table(path: Path) -> NDArray[np.void]:
    with path.open("rb") as stream:
        head = stream.read(MAX_HEADER)
        start, count, dtype, kind = _parse_header(head)
        if kind == "ascii":
            stream.seek(start)
            lines = [stream.readline(4096) for _ in range(count)]
            rows = [tuple(float(word) for word in line.split()[: len(dtype.names or ())]) for line in lines]
            return np.array(rows, dtype=dtype)
        stream.seek(0, 2)
        if stream.tell() < start + count * dtype.itemsize:
            raise ValueError(f"expected {count} vertices, got fewer")
        stream.seek(start)
        return np.frombuffer(stream.read(count * dtype.itemsize), dtype)


def _parse_header(head: bytes) -> tuple[int, int, np.dtype[np.void], str]:
    end = head.find(b"end_header")
    if not head.startswith(b"ply") or end < 0:
        raise ValueError("no header of a PLY file")
    start = head.find(b"\n", end) + 1
    lines = head[:end].decode("ascii", "replace").splitlines()
    kind, count, columns, element = "", 0, [], ""
    for line in lines:
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            kind = words[1]
        elif words[:1] == ["element"] and len(words) == 3:
            if element == "" and words[1] != "vertex":
                raise ValueError("the first element is not vertex")
            element = words[1]
            count = int(words[2]) if element == "vertex" else count
        elif words[:1] == ["property"] and element == "vertex":
            if len(words) != 3 or words[1] not in TYPES:
                raise ValueError(f"unknown property '{line[:60]}'")
            columns.append((words[2], TYPES[words[1]]))
    if kind not in ORDERS or not 0 <= count <= MAX_POINTS or not columns or start == 0:
        raise ValueError("no vertices, or an unknown format")
    return start, count, np.dtype([(name, ORDERS[kind] + code) for name, code in columns]), kind
