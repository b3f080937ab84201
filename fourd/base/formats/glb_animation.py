"""Writes an animated GLB file from the GLB files of single frames.

The triangles differ from frame to frame, so neither skinning nor morph targets can animate the meshes. The file has one
node for each frame instead, and the animation switches the nodes' scales in steps: a node has scale 1 while its frame
is shown, and 0 otherwise.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fourd.base.cameras import Array
from fourd.base.files import atomic_path
from fourd.base.formats.glb import FLOAT, GlbFile, name_errors, pad, read_glb, up_rotation, write_header
from fourd.base.formats.glb_mesh import UNLIT, sampler, textured_material

HIDDEN, SHOWN = [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]


def write_animation(path: Path, frames: Sequence[Path], fps: float, up: Array) -> None:
    """Join the GLB files of the frames into one animated GLB file, which is written atomically.

    Meshes and textures are copied one file at a time, so memory does not grow with the number of frames.

    Args:
        path: the file to write.
        frames: files written by :func:`fourd.base.formats.glb_mesh.write_textured_glb`, in temporal order, at least
            one.
        fps: frames per second, more than 0.
        up: (3,) nonzero up direction of the scene in world coordinates.

    Raises:
        UserError: if a frame's file is missing or damaged, or the animation would be larger than 4 GiB.
        ValueError: if ``frames`` is empty or ``fps`` is not positive.
    """
    if not frames:
        raise ValueError("frames: expected at least one file, got none")
    if not fps > 0:
        raise ValueError(f"fps: expected more than 0, got {fps}")
    files = [read_glb(frame) for frame in frames]
    document = _empty_document(len(files), up)
    offset = 0
    for index, file in enumerate(files):
        with name_errors(file.path):
            _append_frame(document, file, offset, index)
        offset += file.length + -file.length % 4
    keys = _append_keyframes(document, len(files), fps, offset)
    document["buffers"] = [{"byteLength": offset + len(keys)}]
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        write_header(stream, document, offset + len(keys), str(path))
        for file in files:
            with file.path.open("rb") as source:
                source.seek(file.start)
                shutil.copyfileobj(source, stream)
            stream.write(b"\0" * (-file.length % 4))
        stream.write(keys)


def _empty_document(count: int, up: Array) -> dict[str, Any]:
    children = list(range(1, count + 1))
    return {
        "asset": {"version": "2.0", "generator": "fourd mesh"},
        "extensionsUsed": [UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "world", "rotation": up_rotation(up), "children": children}],
        "meshes": [],
        "materials": [],
        "textures": [],
        "samplers": [sampler()],
        "images": [],
        "accessors": [],
        "bufferViews": [],
    }


def _append_frame(document: dict[str, Any], file: GlbFile, offset: int, index: int) -> None:
    """Append one frame's mesh and texture to the document. The frame's binary data starts at ``offset``."""
    first_view, first_accessor = len(document["bufferViews"]), len(document["accessors"])
    for view in file.document["bufferViews"]:
        document["bufferViews"].append(view | {"byteOffset": view.get("byteOffset", 0) + offset})
    for accessor in file.document["accessors"]:
        document["accessors"].append(accessor | {"bufferView": accessor["bufferView"] + first_view})
    primitive = file.document["meshes"][0]["primitives"][0]
    attributes = {name: accessor + first_accessor for name, accessor in primitive["attributes"].items()}
    indices = primitive["indices"] + first_accessor
    image = file.document["images"][0]
    document["images"].append(image | {"bufferView": image["bufferView"] + first_view})
    document["textures"].append({"source": index, "sampler": 0})
    document["materials"].append(textured_material(index))
    document["meshes"].append({"primitives": [{"attributes": attributes, "indices": indices, "material": index}]})
    scale = SHOWN if index == 0 else HIDDEN
    document["nodes"].append({"name": file.path.stem, "mesh": index, "scale": scale})


def _append_keyframes(document: dict[str, Any], count: int, fps: float, offset: int) -> bytes:
    """Append the animation to the document, and return the bytes of its keyframes, which the caller must write at the
    byte ``offset`` of the file's binary part.

    Frame i is shown from i / fps to (i + 1) / fps. The last keyframe of each node is at the end of
    the animation, so that all nodes have the same duration and the animation repeats only after the last frame.
    """
    keys = b""
    samplers, channels = [], []
    for index in range(count):
        times = sorted({0.0, index / fps, (index + 1) / fps, count / fps})
        scales = [SHOWN if index / fps <= time < (index + 1) / fps else HIDDEN for time in times]
        if index == count - 1:
            scales[-1] = SHOWN
        pair = []
        for kind, values in (("SCALAR", times), ("VEC3", [value for scale in scales for value in scale])):
            part = pad(struct.pack(f"<{len(values)}f", *values), b"\0")
            view = {"buffer": 0, "byteOffset": offset + len(keys), "byteLength": len(part)}
            document["bufferViews"].append(view)
            accessor: dict[str, Any] = {"bufferView": len(document["bufferViews"]) - 1, "componentType": FLOAT}
            accessor |= {"count": len(times), "type": kind}
            if kind == "SCALAR":
                stored = struct.unpack(f"<{len(values)}f", part)
                accessor |= {"min": [stored[0]], "max": [stored[-1]]}
            document["accessors"].append(accessor)
            pair.append(len(document["accessors"]) - 1)
            keys += part
        samplers.append({"input": pair[0], "output": pair[1], "interpolation": "STEP"})
        channels.append({"sampler": index, "target": {"node": index + 1, "path": "scale"}})
    document["animations"] = [{"name": "frames", "samplers": samplers, "channels": channels}]
    return keys
