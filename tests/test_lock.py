"""The versions of packages in requirements.lock agree with pyproject.toml and constraints.txt."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from tools.security.lock import EXTRAS, GROUPS

ROOT = Path(__file__).parents[1]
UNLOCKED = {"torch", "fourd"}
"""Builds of torch for CPU and CUDA are different files of the same version."""


def locked() -> dict[str, list[str]]:
    """The hashes of each package in the lock, as "name==version" without markers."""
    hashes: dict[str, list[str]] = {}
    for line in (ROOT / "requirements.lock").read_text().splitlines():
        if line.startswith("    --hash=sha256:"):
            hashes[list(hashes)[-1]].append(line.removeprefix("    --hash=sha256:").removesuffix(" \\"))
        elif line and not line.startswith("#"):
            hashes[line.split(" ")[0]] = []
    return hashes


def name_of(requirement: str) -> str:
    """The normalized name of a package, without extras, versions and markers."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\s\[<>=!~;]", requirement, maxsplit=1)[0]).lower()


def test_every_package_has_hashes() -> None:
    """Catches a package that pip would refuse in hash mode, and a hash that was cut off."""
    for package, hashes in locked().items():
        assert hashes, package
        assert all(re.fullmatch("[0-9a-f]{64}", each) for each in hashes), package


def test_every_dependency_is_locked() -> None:
    """Catches a dependency in pyproject.toml that `make` would not install, because the lock is old."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    wanted = list(settings["project"]["dependencies"])
    wanted += [each for extra in EXTRAS for each in settings["project"]["optional-dependencies"][extra]]
    wanted += [each for group in GROUPS for each in settings["dependency-groups"][group]]
    names = {name_of(package) for package in locked()}
    missing = {name_of(requirement) for requirement in wanted} - names - UNLOCKED
    assert not missing, f"run tools/security/lock.py: {missing}"


def test_locked_versions_are_the_pinned_ones() -> None:
    """Catches a lock file whose versions differ from the versions in constraints.txt, which the README's command
    uses."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {name_of(line): line.partition("==")[2] for line in lines if line and not line.startswith("#")}
    versions: dict[str, set[str]] = {}
    for package in locked():
        versions.setdefault(name_of(package), set()).add(package.partition("==")[2])
    other = {name for name in versions.keys() & pinned.keys() if versions[name] != {pinned[name]}}
    assert not other, f"run tools/security/lock.py: {other}"


def test_make_installs_what_is_locked() -> None:
    """Catches a Makefile that installs other extras or groups than the lock has."""
    makefile = (ROOT / "Makefile").read_text()
    assert f"'.[{','.join(EXTRAS)}]'" in makefile
    assert all(f"--group {group}" in makefile for group in GROUPS)
