"""Gaussian splats in USD files, with the schema ParticleField3DGaussianSplat of the package usd-core.

Each frame is stored in a separate file, so that neither the writer nor a player needs to hold all frames in memory. A
scene file plays these files as value clips. All files state the length of a unit.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.scene.splats.cloud import SplatCloud

PRIM = "/splats"
SCENE = "scene.usda"
SUFFIXES = (".usda", ".usdc", ".usd")
"""File names of one frame, and of the scene file of several frames: text, binary, and binary."""


def require_usd(path: Path) -> None:
    """Raise UserError if the package usd-core is not installed."""
    if importlib.util.find_spec("pxr") is None:
        raise UserError(
            f"{path}: USD files need the package usd-core, which is not installed; pip install 'fourd[splats]'"
        )


def write_splat_usd(path: Path, cloud: SplatCloud, time: float | None = None, metres_per_unit: float = 1.0) -> None:
    """Write one frame as a USD file, atomically. Its suffix, one of :data:`SUFFIXES`, selects text or binary.

    The values are the attributes' default values. If ``time`` is given, they are also time samples at this time code,
    because a value clip uses only time samples; the file stores equal arrays once.

    The cloud must have +y up.
    """
    from pxr import Vt

    terms = cloud.sh.shape[-1]
    with atomic_path(path) as temporary:
        stage, field = _new_stage(temporary, cloud.degree, metres_per_unit)
        harmonics = cloud.sh.transpose(0, 2, 1).reshape(len(cloud) * terms, 3)
        values = (
            Vt.Vec3fArray.FromNumpy(_contiguous(cloud.xyz)),
            Vt.Vec3fArray.FromNumpy(_contiguous(cloud.scale)),
            Vt.QuatfArray.FromNumpy(_contiguous(cloud.rotation[:, [1, 2, 3, 0]])),
            Vt.FloatArray.FromNumpy(_contiguous(cloud.opacity)),
            Vt.Vec3fArray.FromNumpy(_contiguous(harmonics)),
            Vt.Vec3fArray.FromNumpy(_contiguous(cloud.base_colour)),
            Vt.FloatArray.FromNumpy(_contiguous(cloud.opacity)),
            Vt.Vec3fArray.FromNumpy(_extent(cloud)),
        )
        for attribute, value in zip(_attributes(field), values, strict=True):
            attribute.Set(value)
            if time is not None:
                attribute.Set(value, time)
        stage.GetRootLayer().Save()


def write_usd_scene(path: Path, frames: Sequence[str], degree: int, fps: float, metres_per_unit: float = 1.0) -> None:
    """Atomically write a scene file, which plays the files ``frames`` at ``fps`` frames per second.

    Frame i is shown from the time code i until the time code i + 1, without a transition, because the points of
    different frames do not correspond.

    Args:
        frames: paths of the frames' files relative to the folder of ``path``. Frame i has time samples at time code i.
    """
    from pxr import Usd

    with atomic_path(path) as temporary:
        stage, field = _new_stage(temporary, degree, metres_per_unit)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(frames) - 1)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        _attributes(field)
        clips = Usd.ClipsAPI(field.GetPrim())
        clips.SetClipAssetPaths([f"./{name}" for name in frames])
        clips.SetClipPrimPath(PRIM)
        # The scene file itself declares the clips' attributes. Otherwise, USD would open every clip to find them.
        clips.SetClipManifestAssetPath(f"./{path.name}")
        clips.SetClipActive([(float(index), float(index)) for index in range(len(frames))])
        # Two entries with the same stage time are a jump: between them, USD does not interpolate.
        clips.SetClipTimes([(float(index + end), float(index)) for index in range(len(frames)) for end in (0, 1)])
        stage.GetRootLayer().Save()


def _new_stage(path: Path, degree: int, metres_per_unit: float) -> tuple[Any, Any]:
    """Return a new stage, and its only prim, which has no values but the degree of the spherical harmonics."""
    from pxr import Usd, UsdGeom, UsdVol

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, PRIM)
    stage.SetDefaultPrim(field.GetPrim())
    field.CreateRadianceSphericalHarmonicsDegreeAttr().Set(degree)
    return stage, field


def _attributes(field: Any) -> list[Any]:
    """Create the attributes that differ between frames."""
    from pxr import UsdGeom

    return [
        field.CreatePositionsAttr(),
        field.CreateScalesAttr(),
        field.CreateOrientationsAttr(),
        field.CreateOpacitiesAttr(),
        field.CreateRadianceSphericalHarmonicsCoefficientsAttr(),
        field.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).GetAttr(),
        field.CreateDisplayOpacityPrimvar(UsdGeom.Tokens.vertex).GetAttr(),
        field.CreateExtentAttr(),
    ]


def _extent(cloud: SplatCloud) -> NDArray[np.float32]:
    """Return the lower and upper corner (2, 3) of a box that extends three standard deviations beyond each splat's
    centre."""
    margin = 3 * cloud.scale.max(axis=1, keepdims=True)
    if len(cloud) == 0:
        return np.zeros((2, 3), np.float32)
    return np.stack([(cloud.xyz - margin).min(axis=0), (cloud.xyz + margin).max(axis=0)]).astype(np.float32)


def _contiguous(array: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, np.float32)
