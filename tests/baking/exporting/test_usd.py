"""Exports to USD, opened by the package usd-core and checked by its validators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.scene import SceneWriter, open_scene
from fourd.scene.exporting.export import ExportSettings, export_scene
from fourd.scene.splats.ply import read_splat_ply
from tests.baking.scenes import manifest, random_frame

pytest.importorskip("pxr")
FRAMES = 3
Export = Callable[..., list[Path]]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene whose frames have the same number of points, so that a player can interpolate between them."""
    path = tmp_path_factory.mktemp("scene") / "scene.4dv"
    with SceneWriter(path, replace(manifest(frames=FRAMES), metres_per_unit=0.5)) as writer:
        for index in range(FRAMES):
            writer.add_frame(index, random_frame(60, 6, seed=index))
    return path


@pytest.fixture
def export(scene: Path, tmp_path: Path) -> Export:
    def run(name: str, frames: tuple[int, ...] = (0, 1, 2), kind: Any = "usd") -> list[Path]:
        with open_scene(scene) as opened:
            return list(export_scene(opened, tmp_path / name, ExportSettings(kind, frames)).files)

    return run


def open_field(path: Path) -> tuple[Any, Any]:
    """The stage, which must stay referenced, and its prim of splats."""
    from pxr import Usd, UsdVol

    stage = Usd.Stage.Open(str(path))
    return stage, UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())


def values(field: Any, time: float | None = None) -> list[np.ndarray]:
    attributes = (
        field.GetPositionsAttr(),
        field.GetScalesAttr(),
        field.GetOpacitiesAttr(),
        field.GetRadianceSphericalHarmonicsCoefficientsAttr(),
        field.GetDisplayColorAttr(),
        field.GetDisplayOpacityAttr(),
        field.GetExtentAttr(),
    )
    return [np.array(one.Get() if time is None else one.Get(time)) for one in attributes]


def test_every_frame_is_held_until_the_next(export: Export) -> None:
    """Catches points that are interpolated between frames, in which they do not correspond."""
    *frames, path = export("out")
    opened = [open_field(file) for file in frames]
    expected = [values(field) for _, field in opened]
    stage, field = open_field(path)
    for time in (-1.0, 0, 0.25, 0.5, 0.999, 1, 1.5, 1.9999, 2, 2.5, 3, 9):
        shown = min(max(int(time), 0), FRAMES - 1)
        for found, wanted in zip(values(field, time), expected[shown], strict=True):
            np.testing.assert_array_equal(found, wanted, err_msg=f"time {time}")
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)
    assert (stage.GetTimeCodesPerSecond(), stage.GetFramesPerSecond()) == (24, 24)
    assert not np.array_equal(expected[0][0], expected[1][0])


def test_one_frame_has_default_values(export: Export) -> None:
    """Catches a single file that shows nothing without a time code, and a file that is text in spite of its suffix."""
    (cloud_file,) = export("a.ply", (1,), "ply-sequence")
    cloud = read_splat_ply(cloud_file)
    for name, magic in (("a.usdc", b"PXR-USDC"), ("b.usda", b"#usda 1.0"), ("C.USDC", b"PXR-USDC")):
        (path,) = export(name, (1,))
        assert path.read_bytes().startswith(magic)
        stage, field = open_field(path)
        positions, scales, opacities, harmonics, colour, opacity, extent = values(field)
        assert stage.GetDefaultPrim().GetName() == "splats"
        np.testing.assert_allclose(positions[:, 1], -cloud.xyz[:, 1], atol=1e-5)
        np.testing.assert_allclose(scales, cloud.scale, rtol=1e-5)
        np.testing.assert_allclose(opacities, cloud.opacity, atol=1e-5)
        np.testing.assert_array_equal(opacity, opacities)
        np.testing.assert_allclose(colour, cloud.base_colour, atol=1e-4)
        assert harmonics.shape == (9 * len(cloud), 3)
        assert (extent[0] < positions.min(0)).all()
        assert (extent[1] > positions.max(0)).all()
        assert not field.GetPositionsAttr().GetTimeSamples()
        assert field.GetDisplayColorPrimvar().GetInterpolation() == "vertex"


@pytest.mark.parametrize("name", ["out", "walk.usda", "walk.usdc", "one.usdc", "one.usda"])
def test_the_validators_find_no_error(export: Export, name: str) -> None:
    """Catches a missing or wrong unit or up axis, attributes of a wrong type, and clips whose files are not found."""
    validation = pytest.importorskip("pxr.UsdValidation")
    from pxr import UsdGeom

    files = export(name, (1,) if name.startswith("one") else (0, 1, 2))
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    assert {"usdGeomValidators:StageMetadataChecker", "usdValidation:CompositionErrorTest"} <= {
        validator.GetMetadata().name for validator in validators
    }
    for file in files:
        stage, field = open_field(file)
        errors = validation.ValidationContext(validators).Validate(stage)
        assert [(error.GetName(), error.GetMessage()) for error in errors] == []
        assert UsdGeom.GetStageMetersPerUnit(stage) == 0.5
        assert UsdGeom.GetStageUpAxis(stage) == "Y"
        assert len(field.GetPositionsAttr().Get(0)) == 60


def test_a_scene_file_of_any_name_is_written_beside_its_frames(export: Export, tmp_path: Path) -> None:
    """Catches a folder that is called walk.usda."""
    files = export("walk.usda", (0, 2))
    assert [file.relative_to(tmp_path).as_posix() for file in files] == [
        "walk_frames/frame_000010.usdc",
        "walk_frames/frame_000012.usdc",
        "walk.usda",
    ]
    assert files[-1].is_file()


@pytest.mark.parametrize(("kind", "name"), [("usd", "a.usdz"), ("usd", "a.ply"), ("glb", "a.usda"), ("ply", "a.SPLAT")])
def test_the_suffix_of_another_format_is_refused(export: Export, tmp_path: Path, kind: str, name: str) -> None:
    """Catches a folder whose name looks like a file."""
    suffix = name[1:]
    with pytest.raises(
        UserError, match=rf"{name}: expected a folder or a file \.\w+ for --to {kind}, got \{suffix}; name"
    ):
        export(name, (0, 1), kind)
    assert not (tmp_path / name).exists()
