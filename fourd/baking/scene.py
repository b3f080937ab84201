"""What a baked scene is in memory: one frame's arrays, and what holds for all frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera

FORMAT_NAME = "fourd-scene"
FORMAT_VERSION = 2
"""The newest that is read."""
OBJECT_VERSION, FULL_VERSION = 1, 2
"""What is written for each kind: programs that know version 1 alone can still read object scenes."""
SH_TERMS = 16
SHADOW_ONE = 128
"""The shadow that leaves a colour as it is; shadows are bytes, in 1/128."""

SceneKind = Literal["object", "full"]


@dataclass(frozen=True)
class Attribute:
    """One array of a frame as stored: its little-endian dtype and its shape, "points" and "views" by name."""

    name: str
    dtype: str
    shape: tuple[str | int, ...]

    def sized(self, points: int, views: int) -> tuple[int, ...]:
        """The shape in numbers."""
        known = {"points": points, "views": views}
        return tuple(known[side] if isinstance(side, str) else side for side in self.shape)

    def nbytes(self, points: int, views: int) -> int:
        """Size of the array in bytes."""
        count = 1
        for side in self.sized(points, views):
            count *= side
        return count * np.dtype(self.dtype).itemsize


# In the order of BakedFrame's fields.
ATTRIBUTES = (
    Attribute("xyz", "<f4", ("points", 3)),
    Attribute("radius", "<f2", ("points",)),
    Attribute("density", "<f2", ("points",)),
    Attribute("sh", "<f2", ("points", 3, SH_TERMS)),
    Attribute("blend_weights", "<f2", ("points", "views")),
    Attribute("rgb", "|u1", ("points", "views", 3)),
)


@dataclass(frozen=True, eq=False)
class BakedFrame:
    """The N points of one frame and what V source views say of them. All arrays are C-contiguous.

    Attributes:
        xyz: (N, 3) float32, world units.
        radius: (N,) float16, world units.
        density: (N,) float16 in [0, 1].
        sh: (N, 3, 16) float16, degree-3 spherical harmonics of red, green and blue.
        blend_weights: (N, V) float16, not negative, not normalised: shading normalises them over
            the few views that it picks.
        rgb: (N, V, 3) uint8, the point's colour in every source view.
        still: M points, one object for all frames that end with these; None where frames have nothing in common.
        shadowed: whether ``rgb`` of the last M points is not that of ``still``.

    Raises:
        ValueError: naming the array, when a shape or a dtype is wrong.
    """

    xyz: NDArray[np.float32]
    radius: NDArray[np.float16]
    density: NDArray[np.float16]
    sh: NDArray[np.float16]
    blend_weights: NDArray[np.float16]
    rgb: NDArray[np.uint8]
    _: KW_ONLY
    still: BakedFrame | None = None
    shadowed: bool = False

    def __post_init__(self) -> None:
        points = self.xyz.shape[0] if self.xyz.ndim else 0
        views = self.blend_weights.shape[-1] if self.blend_weights.ndim == 2 else 0
        for attribute in ATTRIBUTES:
            array = getattr(self, attribute.name)
            shape = attribute.sized(points, views)
            if array.shape != shape or array.dtype != np.dtype(attribute.dtype):
                raise ValueError(
                    f"{attribute.name}: expected {np.dtype(attribute.dtype)} of shape {shape}, "
                    f"got {array.dtype} of shape {array.shape}"
                )
            object.__setattr__(self, attribute.name, np.ascontiguousarray(array))

    @property
    def point_count(self) -> int:
        """N."""
        return int(self.xyz.shape[0])

    @property
    def dynamic_count(self) -> int:
        """N - M: the first points, which no other frame has."""
        return self.point_count - (0 if self.still is None else self.still.point_count)

    @property
    def view_count(self) -> int:
        """V."""
        return int(self.blend_weights.shape[1])

    @property
    def nbytes(self) -> int:
        """Memory of all arrays in bytes."""
        return sum(getattr(self, attribute.name).nbytes for attribute in ATTRIBUTES)

    def find_invalid_array(self) -> str | None:
        """Name of the first array with NaN, infinity, a negative radius or weight, or a density outside [0, 1]."""
        if not np.isfinite(self.xyz).all():
            return "xyz"
        # float16 is compared as bits, which is several times faster: a sign makes them large, and
        # infinity and NaN begin at 0x7C00.
        for name, limit in (("radius", 0x7BFF), ("density", 0x3C00), ("sh", 0x7BFF), ("blend_weights", 0x7BFF)):
            bits = getattr(self, name).view(np.uint16)
            if name == "sh":
                bits = bits & np.uint16(0x7FFF)
            if bits.size and int(bits.max()) > limit:
                bits = np.where(bits == 0x8000, np.uint16(0), bits)
                if int(bits.max()) > limit:
                    return name
        return None


@dataclass(frozen=True)
class SceneBackground:
    """The static points of a full scene, stored once.

    Attributes:
        points: how many.
        shadow: whether every frame has a factor for the colours of each.
    """

    points: int
    shadow: bool = False


@dataclass(frozen=True)
class SceneManifest:
    """What holds for all frames of a baked scene; the manifest.json of a `.4dv`.

    Attributes:
        source_names, source_cameras: the V source views in the order of the frames' arrays.
        focus: (x, y, z), the point from which view angles are measured.
        bounds: lower and upper corner of what moves, world units.
        frame_numbers: the frames' numbers in the capture; their count is the scene's frame count.
        points: number of points of every frame, without the background's; the writer fills this in.
        other_names, other_cameras: further cameras of the capture, such as held-out views, that
            give no colour but can be rendered by name.
        fps: frames a second when played.
        layers: how many points a pixel composites, K.
        neighbours: how many source views a picture blends, N'.
        sh_range, sh_base: the SH part is ``sh_base + sh_range * tanh(sh . Y(d))``.
        near: points nearer to the camera than this are not drawn, world units.
        kind: "object" on black, or "full", with a static background.
        background: of a full scene; the writer fills this in.
        producer: program and version that wrote the scene.
        version: of the file format; the writer fills this in.

    Raises:
        ValueError: naming the field, when two of them contradict each other.
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
    layers: int = 12
    neighbours: int = 4
    sh_range: float = 0.25
    sh_base: float = 0.0
    near: float = 0.01
    kind: SceneKind = "object"
    background: SceneBackground | None = None
    producer: str = "fourd"
    version: int = OBJECT_VERSION

    def __post_init__(self) -> None:
        if len(self.source_names) != len(self.source_cameras):
            raise ValueError("source_names: expected as many as source_cameras")
        if len(self.other_names) != len(self.other_cameras):
            raise ValueError("other_names: expected as many as other_cameras")
        if len(set(self.names)) != len(self.names):
            raise ValueError(f"source_names and other_names: expected no name twice, got {self.names}")
        if self.points and len(self.points) != self.frame_count:
            raise ValueError("points: expected as many as frame_numbers")
        if self.kind == "object" and self.background is not None:
            raise ValueError('background: expected none in a scene of kind "object"')

    @property
    def frame_count(self) -> int:
        return len(self.frame_numbers)

    @property
    def view_count(self) -> int:
        """V, the number of source views."""
        return len(self.source_names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all cameras: the source views, then the others."""
        return self.source_names + self.other_names

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras, in the order of ``names``."""
        return self.source_cameras + self.other_cameras

    def camera(self, name: str) -> Camera:
        """The camera of that name. Raises KeyError."""
        if name not in self.names:
            raise KeyError(name)
        return self.cameras[self.names.index(name)]

    @property
    def background_nbytes(self) -> int:
        """Memory of the background's arrays in bytes; 0 without one."""
        return 0 if self.background is None else self._nbytes(self.background.points)

    def frame_nbytes(self, frame: int) -> int:
        """Memory of a frame's arrays in bytes, the background's points among them."""
        return self._nbytes(self.points[frame]) + self.background_nbytes

    def _nbytes(self, points: int) -> int:
        return sum(attribute.nbytes(points, self.view_count) for attribute in ATTRIBUTES)


def triple(values: Sequence[float] | NDArray[np.floating]) -> tuple[float, float, float]:
    """Three numbers as the tuple that the manifest wants."""
    x, y, z = (float(value) for value in values)
    return x, y, z
