"""Manifests of scenes. A written manifest must be read back unchanged. A changed manifest must be read, or be rejected
with one error.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fourd.base.errors import UserError
from fourd.scene.manifest import ManifestError, manifest_from_json, manifest_to_json
from fourd.scene.packing.pack import pack_scene
from fourd.scene.scene import SceneManifest
from tests.baking.fuzz.rewrite import rewrite_members
from tests.baking.scenes import read_frames, write_full_scene
from tests.properties.effort import EFFORTS
from tests.properties.json_trees import Tree, changed_trees, trees
from tests.properties.manifests import are_equal, manifests

MEMBER = "manifest.json"


def check_parsing(content: bytes) -> None:
    """Assert that a manifest is rejected with a ManifestError, or that it is unchanged after it is written and read
    again.
    """
    try:
        manifest = manifest_from_json(content)
    except ManifestError as error:
        assert str(error)  # noqa: PT017
        return
    assert are_equal(manifest_from_json(manifest_to_json(manifest)), manifest)


@EFFORTS
def test_written_manifests_are_read_back_equal(effort: settings) -> None:
    """Catches a field that is not written or is rounded, and a valid field that is rejected."""

    @effort
    @given(manifests())
    def check(manifest: SceneManifest) -> None:
        content = manifest_to_json(manifest)
        assert are_equal(manifest_from_json(content), manifest)
        assert manifest_to_json(manifest_from_json(content)) == content

    check()


@EFFORTS
def test_changed_manifests_are_read_or_refused(effort: settings) -> None:
    """Catches exceptions other than ManifestError, and a manifest that can be read but not written."""

    @effort
    @given(manifests().flatmap(lambda manifest: changed_trees(json.loads(manifest_to_json(manifest)))))
    def check(tree: Tree) -> None:
        check_parsing(json.dumps(tree).encode())

    check()


@EFFORTS
def test_any_bytes_are_read_or_refused(effort: settings) -> None:
    """Catches exceptions other than ManifestError for bytes that are not JSON, and for JSON that is not a manifest."""

    @effort
    @given(st.binary(max_size=64) | trees().map(lambda tree: json.dumps(tree).encode()))
    def check(content: bytes) -> None:
        check_parsing(content)

    check()


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A full scene, and a packed copy."""
    folder = tmp_path_factory.mktemp("scenes")
    write_full_scene(folder / "full.4dv", views=3, frames=2, points=40, background_points=30)
    pack_scene(folder / "full.4dv", folder / "packed.4dv", "stream")
    return [folder / "full.4dv", folder / "packed.4dv"]


@EFFORTS
def test_scenes_with_changed_manifests_are_read_or_refused(
    effort: settings, scenes: list[Path], tmp_path: Path
) -> None:
    """Catches a reader of frames that does not check whether the manifest matches the arrays of the scene."""
    sources = [(path, _manifest_of(path)) for path in scenes]

    @effort
    @given(st.sampled_from(sources).flatmap(lambda each: st.tuples(st.just(each[0]), changed_trees(each[1]))))
    def check(case: tuple[Path, Tree]) -> None:
        source, tree = case
        path = tmp_path / "changed.4dv"
        rewrite_members(source, path, lambda members: members.update({MEMBER: json.dumps(tree).encode()}))
        try:
            read_frames(path, 2)
        except UserError as error:
            assert path.name in str(error)  # noqa: PT017

    check()


def _manifest_of(path: Path) -> Tree:
    with zipfile.ZipFile(path) as archive:
        return json.loads(archive.read(MEMBER))
