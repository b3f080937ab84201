"""Conversion of SceneManifest to and from the manifest.json of a `.4dv`.

The parser treats the file as untrusted: it checks the type, range and finiteness of every field. Unknown keys are
skipped.
"""

from __future__ import annotations

import json
import reprlib
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from fourd.base.cameras import Camera
from fourd.base.json_file import Matrix, Vector, decode_json, require_printable
from fourd.base.limits import parse_json, printable
from fourd.base.units import MAX_UNIT_M, MIN_UNIT_M
from fourd.recording.capture.frame_rate import DEFAULT_FPS
from fourd.scene.attributes import ATTRIBUTES
from fourd.scene.files.encoding_json import encoding_from_json, encoding_to_json
from fourd.scene.files.sound import sound_from_json, sound_to_json
from fourd.scene.scene import (
    FORMAT_NAME,
    FORMAT_VERSION,
    FULL_VERSION,
    PACKED_VERSION,
    SOUND_VERSION,
    Count,
    SceneBackground,
    SceneKind,
    SceneManifest,
)

MAX_FRAMES = 1_000_000
MAX_VIEWS = 4096
MAX_SIDE = 1 << 16
MAX_PIXELS = 1 << 25
"""Maximum number of pixels of a camera's image. An 8K image (7680 x 4320) is below this limit."""
Name = Annotated[str, Meta(max_length=255)]
Side = Annotated[int, Meta(ge=1, le=MAX_SIDE)]


class ManifestError(ValueError):
    """Raised for an invalid manifest. The message has the form "manifest.json: where: expected ..., got ..."."""


class NewerVersionError(ManifestError):
    """Raised if the manifest has a newer version than this program supports."""


def manifest_to_json(manifest: SceneManifest) -> bytes:
    """Encode the manifest as UTF-8 JSON. Equal manifests produce equal bytes."""
    content = {
        "format": FORMAT_NAME,
        "version": manifest.version,
        "producer": manifest.producer,
        "kind": manifest.kind,
        **({} if manifest.background is None else {"background": asdict(manifest.background)}),
        "fps": manifest.fps,
        **({"fps_known": True} if manifest.is_fps_known else {}),
        **({} if manifest.metres_per_unit is None else {"metres_per_unit": manifest.metres_per_unit}),
        **sound_to_json(manifest.sound),
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


@dataclass(frozen=True)
class _Header:
    """The keys that manifests of all versions have."""

    format: Name
    version: Annotated[int, Meta(ge=1, le=1 << 31)]


@dataclass(frozen=True)
class _Values:
    """The keys that are also fields of :class:`SceneManifest`."""

    version: int
    producer: Name
    kind: SceneKind
    layers: Annotated[int, Meta(ge=1, le=64)]
    neighbours: Annotated[int, Meta(ge=1, le=64)]
    near: Annotated[float, Meta(ge=1e-12, le=1e9)]
    focus: Vector
    fps: Annotated[float, Meta(ge=1e-3, le=1e4)] = DEFAULT_FPS
    metres_per_unit: Annotated[float, Meta(ge=MIN_UNIT_M, le=MAX_UNIT_M)] | None = None
    fade_views: bool = False
    pixel_filter: Annotated[float, Meta(ge=0, le=0.25)] = 0.0

    def __post_init__(self) -> None:
        require_printable("producer", self.producer)


@dataclass(frozen=True)
class _Sh:
    range: Annotated[float, Meta(ge=0, le=1e3)]
    base: Annotated[float, Meta(ge=-1e3, le=1e3)]


@dataclass(frozen=True)
class _Box:
    lower: Vector
    upper: Vector

    def __post_init__(self) -> None:
        if any(low > high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"expected lower below upper, got {self.lower} and {self.upper}")


@dataclass(frozen=True)
class _View:
    name: Name
    width: Side
    height: Side
    intrinsics: Matrix
    rotation: Matrix
    translation: Vector

    def __post_init__(self) -> None:
        require_printable("name", self.name)
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(f"expected at most {MAX_PIXELS} pixels, got {self.width} x {self.height}")
        _ = self.camera  # the message of an invalid camera names the view

    @cached_property
    def camera(self) -> Camera:
        matrices = np.array(self.intrinsics), np.array(self.rotation), np.array(self.translation)
        return Camera(*matrices, self.width, self.height)


@dataclass(frozen=True)
class _Frame:
    number: Annotated[int, Meta(ge=0, le=1 << 31)]
    points: Count


@dataclass(frozen=True)
class _Parts:
    """The other keys, without those of which the version or the kind decides whether they exist."""

    sh: _Sh
    bounds: _Box
    attributes: dict[str, Any]
    source_views: Annotated[tuple[_View, ...], Meta(max_length=MAX_VIEWS)]
    other_views: Annotated[tuple[_View, ...], Meta(max_length=MAX_VIEWS)]
    frames: Annotated[tuple[_Frame, ...], Meta(max_length=MAX_FRAMES)]
    fps_known: bool = False


@dataclass(frozen=True)
class _Full:
    background: SceneBackground


def manifest_from_json(text: bytes) -> SceneManifest:
    """Parse and check a manifest. Raises ManifestError."""
    try:
        return _decode(parse_json(text))
    except NewerVersionError:
        raise
    except ValueError as error:
        raise ManifestError(f"manifest.json: {error}") from error


def _decode(content: Any) -> SceneManifest:
    header = decode_json(content, _Header)
    if header.format != FORMAT_NAME:
        raise ValueError(f'expected format "{FORMAT_NAME}", got "{printable(header.format)}"')
    if header.version > FORMAT_VERSION:
        raise NewerVersionError(f"expected format version {FORMAT_VERSION} or older, got {header.version}")
    values, parts = decode_json(content, _Values), decode_json(content, _Parts)
    background = _background(content, values)
    is_full, is_packed = background is not None, _is_packed(content, values.version)
    has_sound = values.version >= SOUND_VERSION
    return SceneManifest(
        **vars(values),
        source_names=tuple(view.name for view in parts.source_views),
        source_cameras=tuple(view.camera for view in parts.source_views),
        other_names=tuple(view.name for view in parts.other_views),
        other_cameras=tuple(view.camera for view in parts.other_views),
        bounds=(parts.bounds.lower, parts.bounds.upper),
        frame_numbers=tuple(frame.number for frame in parts.frames),
        points=tuple(frame.points for frame in parts.frames),
        is_fps_known=parts.fps_known,
        sh_range=parts.sh.range,
        sh_base=parts.sh.base,
        background=background,
        optional_attributes=_optional_attributes(parts.attributes),
        encoding=encoding_from_json(content, has_background=is_full) if is_packed else None,
        sound=sound_from_json(content, len(parts.frames) / values.fps) if has_sound else None,
    )


def _is_packed(content: dict[str, Any], version: int) -> bool:
    """Return whether a scene is packed. Scenes with sound are packed if they describe how."""
    return "encoding" in content if version >= SOUND_VERSION else version >= PACKED_VERSION


def _background(content: dict[str, Any], values: _Values) -> SceneBackground | None:
    if values.kind == "object":
        if "background" in content:
            raise ValueError('background: expected no background for kind "object", got one')
        return None
    if values.version < FULL_VERSION:
        raise ValueError(f"kind: expected \"object\" in format version {values.version}, got '{values.kind}'")
    return decode_json(content, _Full).background


def _optional_attributes(given: dict[str, Any]) -> tuple[str, ...]:
    """Check the attributes that this program knows, and return the names of the optional ones among them. Unknown
    attributes are skipped."""
    known = [attribute for attribute in ATTRIBUTES if not attribute.is_optional or attribute.name in given]
    for attribute in known:
        entry = given.get(attribute.name)
        for key, wanted in (("dtype", attribute.dtype), ("shape", list(attribute.shape))):
            got = entry.get(key) if isinstance(entry, dict) else None
            if got != wanted:
                where = f"attributes, {attribute.name}, {key}"
                raise ValueError(f"{where}: expected {json.dumps(wanted)}, got {reprlib.repr(got)}")
    return tuple(attribute.name for attribute in known if attribute.is_optional)


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
