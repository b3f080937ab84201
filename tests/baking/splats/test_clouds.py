"""Clouds of Gaussian splats: files, rotation, and conversion to frames."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fourd.base.errors import UserError
from fourd.rendering.ops.shade.harmonics import SH_CONSTANT, directional_terms
from fourd.scene.shade import shade
from fourd.scene.splats.cloud import SplatCloud, rotate_cloud
from fourd.scene.splats.frames import MAX_HALF, MAX_PIECES, SPLAT_SH_BASE, SPLAT_SH_RANGE, frame_from_splats
from fourd.scene.splats.ply import read_splat_ply, write_splat_ply
from fourd.scene.splats.raw import read_splat, write_splat
from fourd.scene.splats.reader import SplatReader
from tests.baking.damage import damage
from tests.baking.scenes import manifest


def random_cloud(rng: np.random.Generator, count: int = 50, terms: int = 16) -> SplatCloud:
    rotation = rng.normal(size=(count, 4))
    return SplatCloud(
        rng.normal(0, 0.3, (count, 3)).astype(np.float32),
        np.exp(rng.normal(-3, 0.5, (count, 3))).astype(np.float32),
        (rotation / np.linalg.norm(rotation, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0.05, 0.95, count).astype(np.float32),
        rng.normal(0, 0.2, (count, 3, terms)).astype(np.float32),
    )


def colours(cloud: SplatCloud, directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours (N, 3) of the splats seen along unit vectors (N, 3), from the definition of spherical harmonics."""
    basis = np.stack([np.full(len(directions), SH_CONSTANT), *directional_terms(*directions.T)], axis=1)
    return 0.5 + np.einsum("nct,nt->nc", cloud.sh, basis[:, : cloud.sh.shape[-1]])


def covariances(cloud: SplatCloud) -> NDArray[np.float64]:
    axes = Rotation.from_quat(cloud.rotation[:, [1, 2, 3, 0]]).as_matrix()
    return axes @ (cloud.scale[:, :, None] ** 2 * axes.transpose(0, 2, 1))


@pytest.mark.parametrize("terms", [1, 4, 9, 16])
def test_a_ply_file_returns_the_same_cloud(tmp_path: Path, rng: np.random.Generator, terms: int) -> None:
    """Catches a property whose units differ between writer and reader, and permuted harmonics."""
    cloud = random_cloud(rng, terms=terms)
    write_splat_ply(tmp_path / "a.ply", cloud)
    found = read_splat_ply(tmp_path / "a.ply")
    for name in ("xyz", "scale", "rotation", "opacity", "sh"):
        np.testing.assert_allclose(getattr(found, name), getattr(cloud, name), rtol=1e-5, atol=1e-6, err_msg=name)


def test_a_ply_file_of_another_program_is_read_as_3dgs_defines_it(tmp_path: Path) -> None:
    """Catches scales that are not logarithms, opacities that are not logits, and harmonics stored colour by colour."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{index}" for index in range(9)), "opacity"]
    names += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    rest = [1, 2, 3, 10, 20, 30, 100, 200, 300]
    row = [1, 2, 3, 0.1, 0.2, 0.3, *rest, 0, 0, np.log(2), np.log(3), 2, 0, 0, 0]
    lines = ["ply", "format ascii 1.0", "element vertex 1", *(f"property float {name}" for name in names), "end_header"]
    (tmp_path / "a.ply").write_text("\n".join([*lines, " ".join(str(value) for value in row)]) + "\n")
    cloud = read_splat_ply(tmp_path / "a.ply")
    np.testing.assert_allclose(cloud.scale, [[1, 2, 3]], rtol=1e-6)
    np.testing.assert_allclose(cloud.opacity, [0.5])
    np.testing.assert_allclose(cloud.rotation, [[1, 0, 0, 0]])
    np.testing.assert_allclose(cloud.sh[0], [[0.1, 1, 2, 3], [0.2, 10, 20, 30], [0.3, 100, 200, 300]], rtol=1e-6)


def test_a_splat_file_keeps_positions_and_sizes_and_rounds_the_rest(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches rows that are not 32 bytes, and colours or quaternions with a wrong offset."""
    cloud = random_cloud(rng, terms=1)
    write_splat(tmp_path / "a.splat", cloud)
    assert (tmp_path / "a.splat").stat().st_size == 32 * len(cloud)
    found = read_splat(tmp_path / "a.splat")
    order = np.argsort(-cloud.opacity * cloud.scale.prod(axis=1), kind="stable")
    np.testing.assert_array_equal(found.xyz, cloud.xyz[order])
    np.testing.assert_array_equal(found.scale, cloud.scale[order])
    np.testing.assert_allclose(found.opacity, cloud.opacity[order], atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(found.base_colour, cloud.base_colour[order], atol=0.5 / 255 + 1e-6)
    dot = np.abs((found.rotation * cloud.rotation[order]).sum(axis=1))
    assert dot.min() > 0.9999


def test_a_rotated_cloud_looks_the_same_from_rotated_directions(rng: np.random.Generator) -> None:
    """Catches harmonics that are not rotated with the points, and a rotation in the wrong direction."""
    cloud, rotation = random_cloud(rng), Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix()
    turned = rotate_cloud(cloud, rotation)
    directions = rng.normal(size=(len(cloud), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(colours(turned, directions @ rotation.T), colours(cloud, directions), atol=1e-5)
    np.testing.assert_allclose(turned.xyz, cloud.xyz @ rotation.T, atol=1e-5)
    np.testing.assert_allclose(covariances(turned), rotation @ covariances(cloud) @ rotation.T, atol=1e-6)


def test_frames_show_the_colours_of_the_splats(rng: np.random.Generator) -> None:
    """Catches coefficients with a wrong scale, and a range in which tanh changes colours."""
    cloud = replace(random_cloud(rng), scale=np.full((50, 3), 0.02, np.float32))
    frame = frame_from_splats(cloud)
    described = replace(manifest(0), sh_base=SPLAT_SH_BASE, sh_range=SPLAT_SH_RANGE)
    camera = described.cameras[0]
    directions = cloud.xyz - camera.centre
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(shade(frame, camera, described), colours(cloud, directions), atol=0.01)
    np.testing.assert_allclose(frame.radius, 0.04, rtol=1e-3)


def test_a_needle_becomes_points_along_its_longest_axis(rng: np.random.Generator) -> None:
    """Catches a long, thin splat that is converted to a single ball, and pieces that are placed along the wrong
    axis.
    """
    cloud = random_cloud(rng, 1)
    cloud = replace(cloud, scale=np.array([[0.01, 0.06, 0.008]], np.float32))
    frame = frame_from_splats(cloud)
    assert frame.point_count == 6 <= MAX_PIECES
    axis = Rotation.from_quat(cloud.rotation[0, [1, 2, 3, 0]]).as_matrix()[:, 1]
    offsets = frame.xyz - cloud.xyz
    np.testing.assert_allclose(np.abs(offsets @ axis), np.linalg.norm(offsets, axis=1), atol=1e-6)
    assert np.ptp(offsets @ axis) > 0.1
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=1e-6)


def test_splats_that_are_not_finite_are_left_out(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches NaN values that reach the renderer."""
    cloud = random_cloud(rng)
    scale, sh, rotation = cloud.scale.copy(), cloud.sh.copy(), cloud.rotation.copy()
    scale[0, 1], sh[1, 2, 3], rotation[2] = np.nan, np.inf, 0
    broken = SplatCloud(cloud.xyz, scale, rotation, cloud.opacity, sh)
    write_splat_ply(tmp_path / "a.ply", broken)
    write_splat(tmp_path / "a.splat", SplatCloud(cloud.xyz, scale, cloud.rotation, cloud.opacity, cloud.sh[..., :1]))
    assert len(read_splat_ply(tmp_path / "a.ply")) == len(cloud) - 3
    assert len(read_splat(tmp_path / "a.splat")) == len(cloud) - 1


def test_broken_files_are_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches a traceback for a truncated file, and a truncated file that is read without an error."""
    path = tmp_path / "a.ply"
    write_splat_ply(path, random_cloud(rng, terms=4))
    whole = path.read_bytes()
    path.write_bytes(whole[:-8])
    with pytest.raises(UserError, match=r"a\.ply: expected the 50 vertices .* truncated"):
        read_splat_ply(path)
    path.write_bytes(whole.replace(b"f_rest_8", b"f_rezt_8"))
    with pytest.raises(UserError, match=r"a\.ply: expected 0, 9, 24 or 45 properties f_rest_N, got 8"):
        read_splat_ply(path)
    path.write_bytes(whole.replace(b"rot_3", b"ror_3"))
    with pytest.raises(UserError, match=r"a\.ply: expected the properties of Gaussian splats, got no rot_3"):
        read_splat_ply(path)
    (tmp_path / "a.splat").write_bytes(b"x" * 33)
    with pytest.raises(UserError, match=r"a\.splat: expected a multiple of 32 bytes, got 33 bytes"):
        read_splat(tmp_path / "a.splat")
    (tmp_path / "empty.splat").write_bytes(b"")
    with pytest.raises(UserError, match=r"empty\.splat: expected at least one splat with finite values, got none"):
        SplatReader(tmp_path / "empty.splat")


@pytest.mark.parametrize("suffix", [".ply", ".splat"])
def test_random_damage_never_escapes(tmp_path: Path, rng: np.random.Generator, suffix: str) -> None:
    """Catches an exception other than UserError, and values that the renderer does not accept."""
    path = tmp_path / f"a{suffix}"
    cloud = random_cloud(rng, 20, terms=4 if suffix == ".ply" else 1)
    (write_splat_ply if suffix == ".ply" else write_splat)(path, cloud)
    content = path.read_bytes()
    for _ in range(200):
        path.write_bytes(damage(content, rng, 40))
        try:
            frame = SplatReader(path).read(0)
        except UserError as error:
            assert "\n" not in str(error)  # noqa: PT017
        else:
            assert frame.find_invalid_array() is None


def test_huge_splats_print_no_warning(rng: np.random.Generator) -> None:
    """Catches a warning of NumPy between the lines of a command that reads a splat of 10^30 metres."""
    cloud = random_cloud(rng, 4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        frame = frame_from_splats(replace(cloud, scale=np.full((4, 3), 1e30, np.float32)))
    assert (frame.radius == np.float16(MAX_HALF)).all()
