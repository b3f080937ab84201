"""The table of attributes: readers skip unknown attributes, and optional attributes may be missing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fourd.scene.manifest
import fourd.scene.scene
from fourd.base.errors import UserError
from fourd.scene import BakedFrame, SceneReader, SceneWriter, combine_frames, open_scene
from fourd.scene.attributes import ATTRIBUTES, Attribute
from fourd.scene.player import Player
from tests.baking.scenes import full_manifest, manifest, random_frame, room_frame, write_full_scene, write_scene
from tests.baking.test_container import rewritten, with_manifest


def with_unknown_attribute(path: Path, entry: object) -> Path:
    """Copy a scene in the form that a newer program may write. Every frame has an additional member that this program
    does not know.
    """

    def add_member(members: dict[str, bytes]) -> None:
        for name in [name for name in members if name.endswith("/xyz")]:
            members[name.replace("/xyz", "/from_the_future")] = b"\x01\x02\x03"

    def add_entry(content: dict[str, Any]) -> None:
        content["attributes"]["from_the_future"] = entry

    extended = rewritten(path, add_member)
    return with_manifest(extended.rename(path.with_name("extended.4dv")), add_entry)


@pytest.mark.parametrize("entry", [{"dtype": "<f8", "shape": ["points", "bones", 3]}, "anything", None])
@pytest.mark.parametrize("write", [write_scene, write_full_scene])
def test_unknown_attributes_are_skipped(tmp_path: Path, write: Callable[[Path], object], entry: object) -> None:
    """Catches a reader that rejects or checks attributes that only newer programs know."""
    write(tmp_path / "scene.4dv")
    path = with_unknown_attribute(tmp_path / "scene.4dv", entry)
    plain, extended = SceneReader(tmp_path / "scene.4dv"), SceneReader(path)
    camera = plain.manifest.cameras[0]
    for index in range(plain.manifest.frame_count):
        pictures = [Player().draw(reader.read(index), camera, reader.manifest) for reader in (plain, extended)]
        assert np.array_equal(*pictures)
    with open_scene(path) as scene:
        assert scene.render(camera, 0).alpha.max() > 0


@pytest.fixture
def optional_sh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the attribute "sh" optional for a test."""
    table = tuple(replace(item, is_optional=item.is_optional or item.name == "sh") for item in ATTRIBUTES)
    monkeypatch.setattr(fourd.scene.scene, "ATTRIBUTES", table)
    monkeypatch.setattr(fourd.scene.manifest, "ATTRIBUTES", table)


def without_sh(frame: BakedFrame) -> BakedFrame:
    arrays = {name: array for name, array in frame.arrays.items() if name != "sh"}
    return fourd.scene.scene.make_frame(arrays)


@pytest.mark.usefixtures("optional_sh")
@pytest.mark.parametrize("change", [without_sh, lambda frame: frame])
def test_optional_attributes_are_stored_where_frames_have_them(
    tmp_path: Path, change: Callable[[BakedFrame], BakedFrame]
) -> None:
    """Catches a reader that requires optional attributes, and a combination of frames that drops optional
    attributes."""
    own, room = change(random_frame(20, 6, seed=1)), change(room_frame(30, 6, seed=2))
    with SceneWriter(tmp_path / "scene.4dv", full_manifest(frames=1)) as writer:
        writer.add_background(room)
        writer.add_frame(0, own)
    reader = SceneReader(tmp_path / "scene.4dv")
    got, expected = reader.read(0), combine_frames(own, room)
    assert list(got.arrays) == list(expected.arrays) == list(own.arrays)
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(got.arrays[name], array)
    assert reader.manifest.frame_nbytes(0) == got.nbytes


@pytest.mark.usefixtures("optional_sh")
def test_frames_of_one_scene_have_the_same_attributes(tmp_path: Path) -> None:
    """Catches a scene in which only some frames have an optional attribute, because the manifest cannot describe
    this."""
    own, room = random_frame(20, 6, seed=1), without_sh(room_frame(30, 6, seed=2))
    with pytest.raises(ValueError, match=r"background: expected the attributes \['xyz', .*'sh'.*\], got \['xyz'"):
        combine_frames(own, room)
    with (
        pytest.raises(ValueError, match=r"frame 1: expected the optional attributes \('sh',\), got \(\)"),
        SceneWriter(tmp_path / "scene.4dv", manifest()) as writer,
    ):
        writer.add_frame(0, own)
        writer.add_frame(1, without_sh(own))


@pytest.mark.usefixtures("optional_sh")
def test_an_optional_attribute_of_another_shape_is_rejected(tmp_path: Path) -> None:
    """Catches an optional attribute whose values are not checked."""
    write_scene(tmp_path / "scene.4dv")

    def change(content: dict[str, Any]) -> None:
        content["attributes"]["sh"]["shape"] = ["points", 3, 9]

    with pytest.raises(UserError, match="sh, shape: expected"):
        SceneReader(with_manifest(tmp_path / "scene.4dv", change))


@pytest.mark.parametrize(
    ("values", "valid", "invalid"),
    [
        ("finite", [-1, 0, 7], [np.nan, np.inf, -np.inf]),
        ("nonnegative", [0, -0.0, 7], [np.nan, np.inf, -0.5]),
        ("unit", [0, -0.0, 1], [np.nan, np.inf, -0.5, 1.5]),
    ],
)
@pytest.mark.parametrize("dtype", ["<f2", "<f4"])
def test_values_are_checked_as_declared(values: Any, valid: list[float], invalid: list[float], dtype: str) -> None:
    """Catches a wrong limit in the comparison of float16 bits, and -0 treated as a negative number."""
    attribute = Attribute("test", dtype, ("points",), values=values)
    assert attribute.has_valid_values(np.array(valid, dtype))
    assert attribute.has_valid_values(np.array([], dtype))
    for value in invalid:
        assert not attribute.has_valid_values(np.array([*valid, value], dtype))


def test_every_attribute_has_a_field() -> None:
    """Catches an attribute in the table that BakedFrame ignores."""
    fields = BakedFrame.__dataclass_fields__
    assert {item.name for item in ATTRIBUTES} <= set(fields)
