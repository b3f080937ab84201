"""A baked scene in memory: the arrays of a frame, and the manifest that all frames share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene.attributes import ATTRIBUTES, Attribute
from fourd.scene.files.encoding import SceneEncoding
from fourd.scene.files.sound import SceneSound

FORMAT_NAME = "fourd-scene"
FORMAT_VERSION = 5
"""The newest version of the file format that this program can read."""
OBJECT_VERSION, FULL_VERSION, PACKED_VERSION, VIDEO_VERSION, SOUND_VERSION = 1, 2, 3, 4, 5
"""Format versions that are written for object scenes (only dynamic points), full scenes (with a static background),
packed scenes, packed scenes of the tier "video", and scenes with sound, packed or not. A scene is written in the oldest
version that supports its contents, so that older programs can read it."""
SHADOW_IDENTITY = 128
"""The shadow factor that leaves a colour unchanged. Shadows are uint8 factors in units of 1/128."""

BAKED_LAYERS = 12
"""Default maximum number of points that are composited per pixel of an exported scene."""

SceneKind = Literal["object", "full"]
MAX_POINTS = 1 << 26
Count = Annotated[int, Meta(ge=0, le=MAX_POINTS)]
"""Number of points of a frame or of the background."""


@dataclass(frozen=True, eq=False)
class BakedFrame:
    """The N points of one frame, with their colours in V source views. All arrays are C-contiguous.

    Attributes:
        xyz: (N, 3) float32, world units.
        radius: (N,) float16, world units.
        density: (N,) float16 in [0, 1].
        sh: (N, 3, 16) float16, degree-3 spherical harmonics of red, green and blue.
        blend_weights: (N, V) float16, 0 or more. Shading normalizes the blend weights over the selected views.
        rgb: (N, V, 3) uint8, the point's colour in every source view.
        normals: (N, 2) uint8, octahedral unit normals (:func:`fourd.scene.styles.normals.encode_octahedral`) in world
            axes. None if the scene has no normals.
        background: the M background points, as one object that all frames share. They are also the last M points of
            this frame. None if the frame has no background points.
        has_shadow: whether the ``rgb`` of the last M points has been multiplied by a shadow.

    Raises:
        ValueError: for a wrong shape or dtype. The error message names the array.
    """

    xyz: NDArray[np.float32]
    radius: NDArray[np.float16]
    density: NDArray[np.float16]
    sh: NDArray[np.float16]
    blend_weights: NDArray[np.float16]
    rgb: NDArray[np.uint8]
    normals: NDArray[np.uint8] | None = None
    _: KW_ONLY
    background: BakedFrame | None = None
    has_shadow: bool = False

    def __post_init__(self) -> None:
        points = self.xyz.shape[0] if self.xyz.ndim else 0
        views = self.blend_weights.shape[-1] if self.blend_weights.ndim == 2 else 0
        for attribute in ATTRIBUTES:
            array = getattr(self, attribute.name)
            if array is None:
                if attribute.is_optional:
                    continue
                raise ValueError(f"{attribute.name}: expected an array, got None")
            attribute.check(array, points, views)
            object.__setattr__(self, attribute.name, np.ascontiguousarray(array))

    @property
    def attributes(self) -> tuple[Attribute, ...]:
        """The attributes that this frame has, in the order of ATTRIBUTES."""
        return tuple(attribute for attribute in ATTRIBUTES if getattr(self, attribute.name) is not None)

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of :attr:`attributes` by name."""
        return {attribute.name: getattr(self, attribute.name) for attribute in self.attributes}

    @property
    def point_count(self) -> int:
        """N, the number of points."""
        return int(self.xyz.shape[0])

    @property
    def dynamic_count(self) -> int:
        """N - M, the number of dynamic points, which come first."""
        return self.point_count - (0 if self.background is None else self.background.point_count)

    @property
    def view_count(self) -> int:
        """V, the number of source views."""
        return int(self.blend_weights.shape[1])

    @property
    def nbytes(self) -> int:
        """Memory of all arrays in bytes."""
        return sum(array.nbytes for array in self.arrays.values())

    def find_invalid_array(self) -> str | None:
        """Return the name of the first array with a value that :data:`ATTRIBUTES` excludes, such as NaN, or None if all
        arrays are valid."""
        arrays = self.arrays
        for attribute in self.attributes:
            if not attribute.has_valid_values(arrays[attribute.name]):
                return attribute.name
        return None


def make_frame(
    arrays: Mapping[str, NDArray[Any]], background: BakedFrame | None = None, has_shadow: bool = False
) -> BakedFrame:
    """Make a frame from a mapping of attribute names to arrays. Optional attributes may be missing.

    Raises ValueError.
    """
    given: dict[str, Any] = {attribute.name: arrays.get(attribute.name) for attribute in ATTRIBUTES}
    return BakedFrame(**given, background=background, has_shadow=has_shadow)


@dataclass(frozen=True)
class SceneBackground:
    """The static points of a full scene, which are stored once for all frames.

    Attributes:
        points: number of background points.
        shadow: whether every frame has a shadow. A shadow has one colour factor per background point.
    """

    points: Count
    shadow: bool


@dataclass(frozen=True)
class SceneManifest:
    """Metadata that all frames of a baked scene share, stored as the manifest.json of a `.4dv`.

    Attributes:
        source_names, source_cameras: names and cameras of the V source views, in the order of the frames' arrays.
        focus: point (x, y, z), in world units, from which the angles between views are measured.
        bounds: lower and upper corner, in world units, of the box that contains the dynamic points.
        frame_numbers: for each frame, its number in the capture.
        points: number of dynamic points of each frame; set by the writer.
        other_names, other_cameras: names and cameras of the capture's other views, such as held-out views. They
            contribute no colours, but images can be rendered from these cameras by name.
        fps: playback rate, frames per second.
        is_fps_known: true if ``fps`` is the rate of the recording or was set by the user; false if ``fps`` may be a
            default value.
        metres_per_unit: length of a world unit in metres, or None if it is not known.
        layers: maximum number of points that are composited per pixel (K in 4K4D).
        neighbours: number of source views that are blended for a viewing camera (N' in 4K4D).
        fade_views: whether the weight of a source view decreases with its angle to the viewing camera; see
            :func:`fourd.base.cameras.fading_weights`.
        sh_range, sh_base: constants of the view-dependent colour ``sh_base + sh_range * tanh(dot(sh, Y(d)))``, where
            Y(d) are the spherical harmonics in viewing direction d.
        near: depth, in world units, of the near plane. Points with a smaller depth are not rendered.
        pixel_filter: weight of a neighbouring pixel in the filter that is applied to rendered images, from 0 to 0.25;
            see :func:`fourd.rendering.ops.pixel_filter.op.filter_pixels`. If it is 0, images are not filtered.
        kind: "object" (only dynamic points) or "full" (dynamic points and a static background).
        background: static points of a full scene; set by the writer.
        producer: program and version that wrote the scene.
        version: version of the file format; set by the writer.
        optional_attributes: names of the optional attributes that the scene has; set by the writer.
        encoding: quantisation parameters of a packed scene. None if the scene is not packed.
        sound: the sound of the scene, or None if it has none; set by the writer.

    Raises:
        ValueError: if fields contradict each other. The error message names the contradictory fields.
    """

    source_names: tuple[str, ...]
    source_cameras: tuple[Camera, ...]
    focus: tuple[float, float, float]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    frame_numbers: tuple[int, ...]
    points: tuple[int, ...] = ()
    other_names: tuple[str, ...] = ()
    other_cameras: tuple[Camera, ...] = ()
    fps: float = 30.0
    is_fps_known: bool = False
    metres_per_unit: float | None = None
    layers: int = BAKED_LAYERS
    neighbours: int = 4
    fade_views: bool = False
    sh_range: float = 0.25
    sh_base: float = 0.0
    near: float = 0.01
    pixel_filter: float = 0.0
    kind: SceneKind = "object"
    background: SceneBackground | None = None
    producer: str = "fourd"
    version: int = OBJECT_VERSION
    optional_attributes: tuple[str, ...] = ()
    encoding: SceneEncoding | None = None
    sound: SceneSound | None = None

    def __post_init__(self) -> None:
        if len(self.source_names) != len(self.source_cameras):
            raise ValueError("source_names: expected as many names as source_cameras")
        if len(self.other_names) != len(self.other_cameras):
            raise ValueError("other_names: expected as many names as other_cameras")
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"source_names and other_names: expected every name once, got {self.names}")
        if self.points and len(self.points) != self.frame_count:
            raise ValueError("points: expected as many counts as frame_numbers")
        if self.kind == "object" and self.background is not None:
            raise ValueError('expected no background in a scene of kind "object"')

    @property
    def frame_count(self) -> int:
        return len(self.frame_numbers)

    @property
    def seconds(self) -> float:
        """Duration of the scene in seconds."""
        return self.frame_count / self.fps

    @property
    def view_count(self) -> int:
        """V, the number of source views."""
        return len(self.source_names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all cameras: first the source views, then the other views."""
        return self.source_names + self.other_names

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras, in the order of ``names``."""
        return self.source_cameras + self.other_cameras

    def camera(self, name: str) -> Camera:
        """Return the camera ``name``. Raises KeyError if there is no such camera."""
        if name not in self.names:
            raise KeyError(name)
        return self.cameras[self.names.index(name)]

    @property
    def attributes(self) -> tuple[Attribute, ...]:
        """The attributes that the scene stores, in the order of ATTRIBUTES."""
        return select_attributes(self.optional_attributes)

    @property
    def background_nbytes(self) -> int:
        """Memory of the background's arrays in bytes; 0 without a background."""
        return 0 if self.background is None else self._nbytes(self.background.points)

    def frame_nbytes(self, frame: int) -> int:
        """Return the memory of a frame's arrays in bytes, including the background points."""
        return self._nbytes(self.points[frame]) + self.background_nbytes

    def _nbytes(self, points: int) -> int:
        return sum(attribute.nbytes(points, self.view_count) for attribute in self.attributes)


def select_attributes(optional: Iterable[str]) -> tuple[Attribute, ...]:
    """Return the required attributes and those named in ``optional``, in the order of ATTRIBUTES."""
    names = set(optional)
    return tuple(item for item in ATTRIBUTES if not item.is_optional or item.name in names)


def to_triple(values: Sequence[float] | NDArray[np.floating]) -> tuple[float, float, float]:
    """Convert three numbers to a tuple of Python floats, which is the type that the manifest stores."""
    x, y, z = (float(value) for value in values)
    return x, y, z
