"""Generated manifests of scenes, and a comparison of all their fields."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.units import MAX_UNIT_M, MIN_UNIT_M
from fourd.scene.attributes import ATTRIBUTES
from fourd.scene.files.encoding import SH_NUMBERS, TIERS, CloudEncoding, SceneEncoding
from fourd.scene.manifest import MAX_PIXELS
from fourd.scene.scene import (
    FULL_VERSION,
    MAX_POINTS,
    OBJECT_VERSION,
    PACKED_VERSION,
    VIDEO_VERSION,
    SceneBackground,
    SceneManifest,
)

COORDINATES = st.floats(-1e29, 1e29)
NAMES = st.text(min_size=1, max_size=255).filter(str.isprintable)
OPTIONAL = tuple(attribute.name for attribute in ATTRIBUTES if attribute.is_optional)


@st.composite
def arrays(draw: st.DrawFn, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Arrays with a random scale. NumPy draws the numbers from a random seed, because hypothesis would need a long time
    to draw each number."""
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    scale = draw(st.sampled_from((0.0, 1e-40, 1e-3, 1.0, 1e10, 1e29)))
    return (rng.uniform(-1, 1, shape) * scale).astype(np.float32)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    width = draw(st.integers(1, 1 << 16))
    focal = draw(st.floats(1e-3, 1e9))
    return Camera(
        intrinsics=np.array([[focal, 0, draw(COORDINATES)], [0, focal, 0.5], [0, 0, 1]]),
        rotation=rotation,
        translation=np.array(draw(st.tuples(COORDINATES, COORDINATES, COORDINATES))),
        width=width,
        height=draw(st.integers(1, min(1 << 16, MAX_PIXELS // width))),
    )


@st.composite
def clouds(draw: st.DrawFn) -> CloudEncoding:
    return CloudEncoding(
        lower=np.array(draw(st.tuples(COORDINATES, COORDINATES, COORDINATES))),
        position_step=draw(st.floats(1e-30, 1e29)),
        position_bits=draw(st.integers(1, 21)),
        radius_lower=draw(st.floats(1e-30, 1e4)),
        radius_steps=draw(st.integers(1, 1 << 16)),
        density_levels=draw(st.integers(1, 255)),
        sh_basis=draw(arrays((draw(st.integers(0, 3)), SH_NUMBERS))),
        sh_mean=draw(arrays((SH_NUMBERS,))),
        sh_step=draw(st.floats(1e-9, 1e3)),
        weight_steps=draw(st.integers(1, 1 << 16)),
        colour_step=draw(st.integers(1, 127)),
        every_point_has_colours=draw(st.booleans()),
        image_scale=draw(st.none() | st.floats(1 / 64, 1)),
    )


@st.composite
def manifests(draw: st.DrawFn) -> SceneManifest:
    """Valid manifests of all versions, kinds and tiers."""
    version = draw(st.sampled_from((OBJECT_VERSION, FULL_VERSION, PACKED_VERSION, VIDEO_VERSION)))
    is_full = version >= FULL_VERSION and draw(st.booleans())
    views = draw(st.lists(cameras(), max_size=4).map(tuple))
    names = draw(st.lists(NAMES, min_size=len(views), max_size=len(views), unique=True).map(tuple))
    split = draw(st.integers(0, len(views)))
    frames = draw(st.lists(st.tuples(st.integers(0, 1 << 31), st.integers(0, MAX_POINTS)), max_size=4))
    corners = [sorted(draw(st.tuples(COORDINATES, COORDINATES))) for _ in range(3)]
    is_packed = version >= PACKED_VERSION
    return SceneManifest(
        source_names=names[:split],
        source_cameras=views[:split],
        other_names=names[split:],
        other_cameras=views[split:],
        focus=draw(st.tuples(COORDINATES, COORDINATES, COORDINATES)),
        bounds=(tuple(low for low, _ in corners), tuple(high for _, high in corners)),
        frame_numbers=tuple(number for number, _ in frames),
        points=tuple(points for _, points in frames),
        fps=draw(st.floats(1e-3, 1e4)),
        is_fps_known=draw(st.booleans()),
        metres_per_unit=draw(st.none() | st.floats(MIN_UNIT_M, MAX_UNIT_M)),
        layers=draw(st.integers(1, 64)),
        neighbours=draw(st.integers(1, 64)),
        fade_views=draw(st.booleans()),
        sh_range=draw(st.floats(0, 1e3)),
        sh_base=draw(st.floats(-1e3, 1e3)),
        near=draw(st.floats(1e-12, 1e9)),
        pixel_filter=draw(st.floats(0, 0.25)),
        kind="full" if is_full else "object",
        background=SceneBackground(draw(st.integers(0, MAX_POINTS)), draw(st.booleans())) if is_full else None,
        producer=draw(st.text(max_size=255).filter(str.isprintable)),
        version=version,
        optional_attributes=OPTIONAL if draw(st.booleans()) else (),
        encoding=SceneEncoding(draw(st.sampled_from(TIERS)), draw(clouds()), draw(clouds()) if is_full else None)
        if is_packed
        else None,
    )


def are_equal(one: object, other: object) -> bool:
    """Whether two manifests, or parts of them, have the same values with the same types."""
    if type(one) is not type(other):
        return False
    if dataclasses.is_dataclass(one):
        return all(are_equal(getattr(one, each.name), getattr(other, each.name)) for each in dataclasses.fields(one))
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(are_equal(*pair) for pair in zip(one, other, strict=True))
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other)
    return one == other
