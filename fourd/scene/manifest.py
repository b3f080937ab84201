"""Conversion of SceneManifest to and from the manifest.json of a `.4dv`.

The parser treats the file as untrusted: it checks the type, range and finiteness of every field. Unknown keys are
skipped.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.capture.frame_rate import DEFAULT_FPS
from fourd.scene.attributes import ATTRIBUTES
from fourd.scene.files.encoding_json import encoding_from_json, encoding_to_json
from fourd.scene.files.json_node import JsonNode, ManifestError
from fourd.scene.scene import (
    FORMAT_NAME,
    FORMAT_VERSION,
    FULL_VERSION,
    PACKED_VERSION,
    SceneBackground,
    SceneKind,
    SceneManifest,
)

MAX_FRAMES = 1_000_000
MAX_POINTS = 1 << 26
MAX_VIEWS = 4096
MAX_SIDE = 1 << 16
MAX_PIXELS = 1 << 25
"""Maximum number of pixels of a camera's image. An 8K image (7680 x 4320) is below this limit."""
KINDS: tuple[SceneKind, ...] = ("object", "full")


class NewerVersionError(ManifestError):
    """Raised if the manifest has a newer version than this program supports."""


def manifest_to_json(manifest: SceneManifest) -> bytes:
    """Encode the manifest as UTF-8 JSON. Equal manifests produce equal bytes."""
    content = {
        "format": FORMAT_NAME,
        "version": manifest.version,
        "producer": manifest.producer,
        "kind": manifest.kind,
        **_background_to_json(manifest.background),
        "fps": manifest.fps,
        **({"fps_known": True} if manifest.is_fps_known else {}),
        "layers": manifest.layers,
        "neighbours": manifest.neighbours,
        **({"fade_views": True} if manifest.fade_views else {}),
        "near": manifest.near,
        **({"pixel_filter": manifest.pixel_filter} if manifest.pixel_filter else {}),
        "sh": {"range": manifest.sh_range, "base": manifest.sh_base},
        "focus": list(manifest.focus),
        "bounds": {"lower": list(manifest.bounds[0]), "upper": list(manifest.bounds[1])},
        **({} if manifest.encoding is None else {"encoding": encoding_to_json(manifest.encoding)}),
        "attributes": {item.name: {"dtype": item.dtype, "shape": list(item.shape)} for item in manifest.attributes},
        "source_views": _views_to_json(manifest.source_names, manifest.source_cameras),
        "other_views": _views_to_json(manifest.other_names, manifest.other_cameras),
        "frames": [
            {"number": number, "points": points}
            for number, points in zip(manifest.frame_numbers, manifest.points, strict=True)
        ],
    }
    return json.dumps(content, indent=1, allow_nan=False).encode()


def manifest_from_json(text: bytes) -> SceneManifest:
    """Parse and check a manifest. Raises ManifestError."""
    try:
        content = json.loads(text.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ManifestError(f"manifest.json: expected UTF-8 JSON, got other content ({error})") from error
    root = JsonNode(content, "manifest.json")
    if root.text("format") != FORMAT_NAME:
        raise ManifestError(f'manifest.json: expected format "{FORMAT_NAME}", got "{root.text("format")}"')
    version = root.integer("version", 1, 1 << 31)
    if version > FORMAT_VERSION:
        raise NewerVersionError(f"expected format version {FORMAT_VERSION} or older, got {version}")
    optional_attributes = _check_attributes(root.node("attributes"))
    source_names, source_cameras = _views(root.items("source_views", MAX_VIEWS))
    other_names, other_cameras = _views(root.items("other_views", MAX_VIEWS))
    kind = root.choice("kind", KINDS)
    background = _background(root, kind, version)
    frames = root.items("frames", MAX_FRAMES)
    sh = root.node("sh")
    try:
        return SceneManifest(
            source_names=source_names,
            source_cameras=source_cameras,
            focus=root.triple("focus"),
            bounds=_bounds(root.node("bounds")),
            frame_numbers=tuple(frame.integer("number", 0, 1 << 31) for frame in frames),
            points=tuple(frame.integer("points", 0, MAX_POINTS) for frame in frames),
            other_names=other_names,
            other_cameras=other_cameras,
            fps=root.number("fps", 1e-3, 1e4) if "fps" in root.content else DEFAULT_FPS,
            is_fps_known="fps_known" in root.content and root.flag("fps_known"),
            layers=root.integer("layers", 1, 64),
            neighbours=root.integer("neighbours", 1, 64),
            fade_views="fade_views" in root.content and root.flag("fade_views"),
            sh_range=sh.number("range", 0, 1e3),
            sh_base=sh.number("base", -1e3, 1e3),
            near=root.number("near", 1e-12, 1e9),
            pixel_filter=root.number("pixel_filter", 0, 0.25) if "pixel_filter" in root.content else 0.0,
            kind=kind,
            background=background,
            producer=root.text("producer"),
            version=version,
            optional_attributes=optional_attributes,
            encoding=encoding_from_json(root.node("encoding"), has_background=background is not None)
            if version >= PACKED_VERSION
            else None,
        )
    except ManifestError:
        raise
    except ValueError as error:
        raise ManifestError(f"manifest.json: {error}") from error


def _background_to_json(background: SceneBackground | None) -> dict[str, Any]:
    if background is None:
        return {}
    return {"background": {"points": background.points, "shadow": background.shadow}}


def _background(root: JsonNode, kind: SceneKind, version: int) -> SceneBackground | None:
    if kind == "object":
        if "background" in root.content:
            raise root.fail("background", 'no background for kind "object"')
        return None
    if version < FULL_VERSION:
        raise root.fail("kind", f'"object" in format version {version}')
    node = root.node("background")
    return SceneBackground(node.integer("points", 0, MAX_POINTS), node.flag("shadow"))


def _bounds(node: JsonNode) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    lower, upper = node.triple("lower"), node.triple("upper")
    if any(low > high for low, high in zip(lower, upper, strict=True)):
        raise ManifestError(f"{node.where}: expected lower below upper, got {lower} and {upper}")
    return lower, upper


def _check_attributes(node: JsonNode) -> tuple[str, ...]:
    """Check the attributes that this program knows, and return the names of the optional ones among them. Unknown
    attributes are skipped."""
    optional = []
    for attribute in ATTRIBUTES:
        if attribute.is_optional:
            if attribute.name not in node.content:
                continue
            optional.append(attribute.name)
        given = node.node(attribute.name)
        if given.get("dtype") != attribute.dtype:
            raise given.fail("dtype", f'"{attribute.dtype}"')
        if given.get("shape") != list(attribute.shape):
            raise given.fail("shape", f"{list(attribute.shape)}")
    return tuple(optional)


def _views_to_json(names: tuple[str, ...], cameras: tuple[Camera, ...]) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "width": camera.width,
            "height": camera.height,
            "intrinsics": camera.intrinsics.tolist(),
            "rotation": camera.rotation.tolist(),
            "translation": camera.translation.tolist(),
        }
        for name, camera in zip(names, cameras, strict=True)
    ]


def _views(nodes: list[JsonNode]) -> tuple[tuple[str, ...], tuple[Camera, ...]]:
    return tuple(node.text("name") for node in nodes), tuple(_camera(node) for node in nodes)


def _camera(node: JsonNode) -> Camera:
    width, height = node.integer("width", 1, MAX_SIDE), node.integer("height", 1, MAX_SIDE)
    if width * height > MAX_PIXELS:
        raise ManifestError(f"{node.where}: expected at most {MAX_PIXELS} pixels, got {width} x {height}")
    try:
        return Camera(
            intrinsics=np.array(node.matrix("intrinsics")),
            rotation=np.array(node.matrix("rotation")),
            translation=np.array(node.numbers("translation", 3)),
            width=width,
            height=height,
        )
    except ManifestError:
        raise
    except ValueError as error:
        raise ManifestError(f"{node.where}, {error}") from error
