"""Read and write coloured points and triangles in PLY files.

The reader accepts ASCII files and binary files of both byte orders; the writer writes binary little-endian files.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.base.formats.ply_colours import GREY, convert_colours, find_colours, require_opaque
from fourd.base.limits import open_regular

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip

MAX_HEADER_BYTES = 1 << 16


class ColouredPoints(NamedTuple):
    """Coloured points.

    Attributes:
        xyz: (N, 3) float32 positions in world units, all finite.
        rgb: (N, 3) uint8 sRGB colours.
    """

    xyz: NDArray[np.float32]
    rgb: NDArray[np.uint8]


def write_ply(
    path: Path | str,
    xyz: NDArray[np.floating[Any]],
    rgb: NDArray[np.uint8],
    normals: NDArray[np.floating[Any]] | None = None,
    triangles: NDArray[np.integer[Any]] | None = None,
) -> None:
    """Write points (N, 3) and their colours (N, 3) uint8 as binary PLY, atomically.

    If given, the unit ``normals`` (N, 3) and the ``triangles`` (M, 3), which are vertex indices, are also written.

    Raises:
        ValueError: if a shape or the colours' dtype is wrong, or a coordinate is not finite.
    """
    if xyz.ndim != 2 or xyz.shape[1] != 3 or not np.isfinite(xyz).all():
        raise ValueError(f"xyz: expected finite coordinates of shape (N, 3), got shape {xyz.shape} or NaN values")
    if rgb.shape != xyz.shape or rgb.dtype != np.uint8:
        raise ValueError(f"rgb: expected uint8 of shape {xyz.shape}, got {rgb.dtype} of shape {rgb.shape}")
    columns: dict[str, NDArray[Any]] = {name: xyz[:, axis].astype("<f4") for axis, name in enumerate("xyz")}
    if normals is not None:
        columns |= {name: normals[:, axis].astype("<f4") for axis, name in enumerate(("nx", "ny", "nz"))}
    columns |= {name: rgb[:, channel] for channel, name in enumerate(("red", "green", "blue"))}
    rows = np.empty(len(xyz), dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    write_vertices(path, rows, triangles)


def write_vertices(path: Path | str, rows: NDArray[Any], triangles: NDArray[np.integer[Any]] | None = None) -> None:
    """Write vertices, and triangles if they are given, as binary PLY, atomically.

    Args:
        path: the file.
        rows: structured array (N,). Each of its fields, little-endian float32 or uint8, becomes a PLY property of the
            same name.
        triangles: (M, 3) vertex indices.
    """
    assert rows.dtype.names is not None
    words = {np.dtype("<f4"): "float", np.dtype("u1"): "uchar"}
    kinds = "\n".join(f"property {words[rows.dtype[name]]} {name}" for name in rows.dtype.names)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{kinds}\n"
    faces = np.empty(0 if triangles is None else len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    if triangles is not None:
        header += f"element face {len(triangles)}\nproperty list uchar int vertex_indices\n"
        faces["count"], faces["corners"] = 3, triangles
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(f"{header}end_header\n".encode("ascii"))
        stream.write(rows.tobytes())
        stream.write(faces.tobytes())


def read_ply(path: Path | str) -> ColouredPoints:
    """Read the vertices of a PLY file, which may be ASCII or binary of either byte order.

    Colours may have the names, types and ranges that :mod:`fourd.base.formats.ply_colours` describes. Points without
    colours become medium grey. All other vertex properties, and all elements after the vertices, are skipped.

    Raises:
        UserError: if the file is missing, is not a PLY file, is shorter than its header declares, lacks x, y or z,
            contains coordinates that are not finite, has colours whose range is not clear, or has transparent points.
            The error message names the file.
    """
    path = Path(path)
    header, rows = _read_rows(path)
    xyz = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float32)
    if not np.isfinite(xyz).all():
        raise _invalid(
            path, "finite coordinates", f"{int((~np.isfinite(xyz)).any(axis=1).sum())} points with NaN or infinity"
        )
    names = find_colours(path, header.names)
    if names is None:
        return ColouredPoints(xyz, np.full(xyz.shape, GREY, dtype=np.uint8))
    if "alpha" in header.names:
        require_opaque(path, rows["alpha"].astype(np.float64))
    types = dict(header.properties)
    values = np.stack([rows[name] for name in names], axis=1).astype(np.float64)
    return ColouredPoints(xyz, convert_colours(path, values, {name: types[name] for name in names}))


def read_vertices(path: Path) -> NDArray[Any]:
    """Read the vertices of a PLY file as a structured array (N,) with one field for each property.

    Raises:
        UserError: in the same cases as :func:`read_ply`, but the values themselves cause no error.
    """
    return _read_rows(path)[1]


def _read_rows(path: Path) -> tuple[PlyHeader, NDArray[Any]]:
    header, body = _read(path, -1)
    return header, _ascii_rows(path, header, body) if header.order is None else _binary_rows(path, header, body)


def read_faces(path: Path) -> NDArray[np.int32]:
    """Read the triangles of a PLY file as vertex indices (T, 3). The faces must directly follow the vertices.

    Raises:
        UserError: if the file is not a valid PLY file, or has faces that are not triangles.
    """
    header, body = _read(path, -1)
    if header.faces is None:
        raise _invalid(path, "triangles as a list of vertex indices after the vertices", "a file without them")
    if header.order is None:
        lines = [line.split() for line in body.split(b"\n") if line.strip()][header.count :]
        lines = lines[: header.faces.count]
        if len(lines) < header.faces.count or any(len(line) != 4 or line[0] != b"3" for line in lines):
            raise _invalid(path, f"{header.faces.count} triangles", "fewer faces or other polygons")
        try:
            return np.array([line[1:] for line in lines], dtype=np.int64).clip(-1, 2**31 - 1).astype(np.int32)
        except ValueError as error:
            raise _invalid(path, "whole numbers as vertex indices", "a line with text") from error
    count, corners = (f"{header.order}{code}" for code in header.faces.types)
    kind = np.dtype([("count", count), ("corners", corners, 3)])
    start = header.count * np.dtype([(name, f"{header.order}{code}") for name, code in header.properties]).itemsize
    if len(body) < start + header.faces.count * kind.itemsize:
        raise _invalid(path, f"{header.faces.count} triangles", "other polygons, or a truncated file")
    rows = np.frombuffer(body, kind, header.faces.count, start)
    if (rows["count"] != 3).any():
        raise _invalid(path, "triangles", "other polygons")
    return rows["corners"].astype(np.int64).clip(-1, 2**31 - 1).astype(np.int32).reshape(-1, 3)


def read_header(path: Path) -> PlyHeader:
    """Read the header of a PLY file. Raises UserError if the header is not valid."""
    return _read(path, 0)[0]


@dataclass(frozen=True)
class FaceLayout:
    """How faces are stored: their number, and the NumPy types of a face's vertex count and of its vertex indices."""

    count: int
    types: tuple[str, str]


@dataclass(frozen=True)
class PlyHeader:
    """The header of a PLY file.

    Attributes:
        order: NumPy's character for the byte order ("<" or ">"), or None for ASCII files.
        count: number of vertices that the header declares.
        properties: names and NumPy types of the vertex properties.
        faces: the faces, if they directly follow the vertices and have only vertex indices; otherwise None.
    """

    order: str | None
    count: int
    properties: tuple[tuple[str, str], ...]
    faces: FaceLayout | None = None

    @property
    def names(self) -> frozenset[str]:
        """Names of the properties."""
        return frozenset(name for name, _ in self.properties)


def _read(path: Path, body_bytes: int) -> tuple[PlyHeader, bytes]:
    try:
        with open_regular(path) as stream:
            return _read_header(path, stream), stream.read(body_bytes)
    except OSError as error:
        raise UserError(f"{path}: expected a readable PLY file, got {error.strerror}; check the path") from error


def _read_header(path: Path, stream: BinaryIO) -> PlyHeader:
    lines = _header_lines(path, stream)
    order, count, element = "", -1, ""
    properties: list[tuple[str, str]] = []
    for words in lines:
        if words[0] == "format" and len(words) >= 2:
            order = words[1]
        elif words[0] == "element" and len(words) == 3:
            if count < 0 and words[1] != "vertex":
                raise _invalid(path, "vertices as its first element", f"element {words[1]}")
            element = words[1]
            count = _count(path, words[2]) if element == "vertex" else count
        elif words[0] == "property" and element == "vertex":
            if len(words) != 3 or words[1] not in TYPES or words[2] in dict(properties):
                raise _invalid(path, "scalar vertex properties, each once", f"'{' '.join(words)}'")
            properties.append((words[2], TYPES[words[1]]))
    orders = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
    if order not in orders:
        raise _invalid(path, f"a format of {', '.join(orders)}", f"'{order}'")
    if count < 0 or not {"x", "y", "z"} <= set(dict(properties)):
        raise _invalid(path, "an element 'vertex' with properties x, y, z", f"{[name for name, _ in properties]}")
    return PlyHeader(orders[order], count, tuple(properties), _face_layout(path, lines))


def _face_layout(path: Path, lines: list[list[str]]) -> FaceLayout | None:
    elements = [words for words in lines if words[0] == "element"]
    if len(elements) < 2 or len(elements[1]) != 3 or elements[1][1] != "face":
        return None
    after = lines[lines.index(elements[1]) + 1 :]
    others = [index for index, words in enumerate(after) if words[0] == "element"]
    properties = [words for words in after[: min(others, default=len(after))] if words[0] == "property"]
    if len(properties) != 1 or len(properties[0]) != 5 or properties[0][1] != "list":
        return None
    _, _, length, index, name = properties[0]
    if name not in ("vertex_indices", "vertex_index") or length not in TYPES or index not in TYPES:
        return None
    return FaceLayout(_count(path, elements[1][2]), (TYPES[length], TYPES[index]))


def _header_lines(path: Path, stream: BinaryIO) -> list[list[str]]:
    if stream.readline(8).strip() != b"ply":
        raise _invalid(path, "a PLY file that starts with 'ply'", "other content")
    lines: list[list[str]] = []
    size = 0
    while size < MAX_HEADER_BYTES:
        line = stream.readline(4096)
        size += len(line)
        words = line.decode("latin-1").split()
        if not line or words == ["end_header"]:
            break
        if words and words[0] not in ("comment", "obj_info"):
            lines.append(words)
    else:
        line = b""
    if not line:
        raise _invalid(path, "a header that ends with 'end_header'", "a header without an end")
    return lines


def _count(path: Path, word: str) -> int:
    if not word.isascii() or not word.isdigit() or len(word) > 15:
        raise _invalid(path, "a whole number of vertices", f"'{word[:40]}'")
    return int(word)


def _binary_rows(path: Path, header: PlyHeader, body: bytes) -> NDArray[Any]:
    kind = np.dtype([(name, f"{header.order}{code}") for name, code in header.properties])
    if len(body) < header.count * kind.itemsize:
        raise _truncated(path, header.count, len(body) // kind.itemsize)
    return np.frombuffer(body, dtype=kind, count=header.count)


def _ascii_rows(path: Path, header: PlyHeader, body: bytes) -> NDArray[Any]:
    lines = body.split(b"\n", header.count)[: header.count] if header.count <= len(body) else body.split(b"\n")
    lines = [line for line in lines if line.strip()]
    if len(lines) < header.count:
        raise _truncated(path, header.count, len(lines))
    width = len(header.properties)
    try:
        values = np.array([line.split()[:width] for line in lines], dtype=np.float64).reshape(-1, width)
    except ValueError as error:
        raise _invalid(
            path, f"{width} numbers on every vertex line", "a line with fewer values or with text"
        ) from error
    kind = np.dtype([(name, code if code in ("f4", "u1") else "f8") for name, code in header.properties])
    rows = np.empty(len(values), dtype=kind)
    for i, (name, code) in enumerate(header.properties):
        rows[name] = values[:, i].clip(0, 255) if code == "u1" else values[:, i]
    return rows


def _truncated(path: Path, declared: int, found: int) -> UserError:
    return UserError(
        f"{path}: expected the {declared} vertices that the header declares, got {found}; the file is truncated: "
        "write the file again"
    )


def _invalid(path: Path, expected: str, got: str) -> UserError:
    return UserError(f"{path}: expected {expected}, got {got}; write the file again as a PLY point cloud")
