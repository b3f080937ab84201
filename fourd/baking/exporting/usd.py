"""Gaussian splats in USD files, with the schema ParticleField3DGaussianSplat of the package usd-core.

Each frame is stored in a separate file, so that neither the writer nor a player needs to hold all frames in memory. The
file ``scene.usda`` plays these files as value clips.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.baking.splats.cloud import SplatCloud
from fourd.errors import UserError
from fourd.files import atomic_path

PRIM = "/splats"
SCENE = "scene.usda"


def require_usd(path: Path) -> None:
    """Raise UserError if the package usd-core is not installed."""
    if importlib.util.find_spec("pxr") is None:
        raise UserError(
            f"{path}: USD files need the package usd-core, which is not installed; pip install 'fourd[splats]'"
        )


def write_splat_usd(path: Path, cloud: SplatCloud, time: float) -> None:
    """Write one frame as a binary USD file (`.usdc`), atomically. The attribute values are time samples at the time
    code ``time``.

    The cloud must have +y up.
    """
    from pxr import Usd, UsdGeom, UsdVol, Vt

    terms = cloud.sh.shape[-1]
    with atomic_path(path) as temporary:
        stage = Usd.Stage.CreateNew(str(temporary))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        field = UsdVol.ParticleField3DGaussianSplat.Define(stage, PRIM)
        stage.SetDefaultPrim(field.GetPrim())
        field.CreateRadianceSphericalHarmonicsDegreeAttr().Set(cloud.degree)
        harmonics = cloud.sh.transpose(0, 2, 1).reshape(len(cloud) * terms, 3)
        extent = _extent(cloud)
        values = (
            (field.CreatePositionsAttr(), Vt.Vec3fArray.FromNumpy(_contiguous(cloud.xyz))),
            (field.CreateScalesAttr(), Vt.Vec3fArray.FromNumpy(_contiguous(cloud.scale))),
            (field.CreateOrientationsAttr(), Vt.QuatfArray.FromNumpy(_contiguous(cloud.rotation[:, [1, 2, 3, 0]]))),
            (field.CreateOpacitiesAttr(), Vt.FloatArray.FromNumpy(_contiguous(cloud.opacity))),
            (field.CreateRadianceSphericalHarmonicsCoefficientsAttr(), Vt.Vec3fArray.FromNumpy(_contiguous(harmonics))),
            (field.CreateDisplayColorAttr(), Vt.Vec3fArray.FromNumpy(_contiguous(cloud.base_colour))),
            (field.CreateExtentAttr(), Vt.Vec3fArray.FromNumpy(extent)),
        )
        for attribute, value in values:
            attribute.Set(value, time)
        stage.GetRootLayer().Save()


def write_usd_scene(folder: Path, frames: Sequence[str], degree: int, fps: float) -> None:
    """Atomically write ``scene.usda``, which plays the files ``frames`` of ``folder`` at ``fps`` frames per second.

    The frames have the time codes 0, 1, 2 and so on.
    """
    from pxr import Usd, UsdGeom, UsdVol

    with atomic_path(folder / SCENE) as temporary:
        stage = Usd.Stage.CreateNew(str(temporary))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(len(frames) - 1)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        field = UsdVol.ParticleField3DGaussianSplat.Define(stage, PRIM)
        stage.SetDefaultPrim(field.GetPrim())
        field.CreateRadianceSphericalHarmonicsDegreeAttr().Set(degree)
        for create in _animated(field):
            create()
        clips = Usd.ClipsAPI(field.GetPrim())
        clips.SetClipAssetPaths([f"./{name}" for name in frames])
        clips.SetClipPrimPath(PRIM)
        clips.SetClipActive([(float(index), float(index)) for index in range(len(frames))])
        clips.SetClipTimes([(float(index), float(index)) for index in range(len(frames))])
        stage.GetRootLayer().Save()


def _animated(field: Any) -> list[Any]:
    return [
        field.CreatePositionsAttr,
        field.CreateScalesAttr,
        field.CreateOrientationsAttr,
        field.CreateOpacitiesAttr,
        field.CreateRadianceSphericalHarmonicsCoefficientsAttr,
        field.CreateDisplayColorAttr,
        field.CreateExtentAttr,
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
