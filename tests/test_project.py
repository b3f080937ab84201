"""Files by which people find, cite and contribute to the project agree with each other."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[1]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))


def project() -> dict[str, Any]:
    """The table [project] of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_actions_are_pinned_by_hash(path: Path) -> None:
    """Catches an action that is named by a tag. The owner of the action, or an attacker, can move a tag to other code,
    which then runs with the rights of the workflow."""
    text = path.read_text(encoding="utf-8")
    assert "jobs" in yaml.safe_load(text)
    for use in re.findall(r"uses: *(.+)", text):
        assert re.fullmatch(r"[\w.-]+(/[\w.-]+)+@[0-9a-f]{40} # v\d[\w.]*", use), use


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_have_few_rights(path: Path) -> None:
    """Catches a workflow whose jobs may write to the repository unless a job says otherwise."""
    assert yaml.safe_load(path.read_text(encoding="utf-8"))["permissions"] == {"contents": "read"}


def test_reports_of_problems_ask_for_the_system() -> None:
    """Catches a form that is not valid YAML, and reports without the versions and the machine."""
    forms = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in FORMS}
    asked = [field for field in forms["problem"]["body"] if field.get("id") == "system"]
    assert "`fourd info --system`" in asked[0]["attributes"]["label"]
    assert asked[0]["validations"]["required"]
    assert "`fourd info --system`" in (ROOT / ".github" / "pull_request_template.md").read_text(encoding="utf-8")


def test_the_citation_has_the_version_and_the_licence() -> None:
    """Catches a citation that names an earlier version, and one that the README contradicts."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert str(citation["version"]) == project()["version"]
    assert citation["license"] == project()["license"]
    assert citation["authors"] == project()["authors"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert f"version = {{{project()['version']}}}" in readme
    assert all(f"{author['family-names']}, " in readme for author in citation["preferred-citation"]["authors"])


@pytest.mark.parametrize("name", ["pyproject.toml", "mkdocs.yml", "CITATION.cff", "README.md"])
def test_no_address_is_a_placeholder(name: str) -> None:
    """Catches an address that leads nowhere, on the page of the package or as the canonical address of the site."""
    assert re.findall(r"https?://[\w.-]*\bexample\b[\w./-]*", (ROOT / name).read_text(encoding="utf-8")) == []


def test_the_site_takes_its_address_from_the_workflow() -> None:
    """Catches a published site whose pages name another address, and one without a map for search engines."""
    assert 'site_url: !ENV [SITE_URL, ""]' in (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    steps = yaml.safe_load((ROOT / ".github/workflows/pages.yml").read_text(encoding="utf-8"))["jobs"]["build"]["steps"]
    (build,) = [step for step in steps if step.get("run") == "make docs"]
    assert build["env"] == {"SITE_URL": "${{ steps.pages.outputs.base_url }}/"}


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
@pytest.mark.parametrize(("owner", "code"), [("owner", 0), ("other", 1)])
def test_a_release_links_to_its_repository(owner: str, code: int, tmp_path: Path) -> None:
    """Catches a release without links to the source. Files on PyPI cannot be replaced, so it would never have any."""
    workflow = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8"))
    (script,) = [step["run"] for step in workflow["jobs"]["version"]["steps"] if "links" in step.get("name", "")]
    urls = '[project.urls]\nSource = "https://git.test/owner/fourd"\n'
    (tmp_path / "pyproject.toml").write_text(urls, encoding="utf-8")
    names = {"GITHUB_SERVER_URL": "https://git.test", "GITHUB_REPOSITORY": f"{owner}/fourd"}
    done = subprocess.run(["bash", "-e", "-c", script], cwd=tmp_path, env={**os.environ, **names}, capture_output=True)
    assert done.returncode == code


def test_configurations_of_editors_and_services_are_valid() -> None:
    """Catches a typing error in files that no other test reads."""
    container = json.loads((ROOT / ".devcontainer" / "devcontainer.json").read_text(encoding="utf-8"))
    assert "make install" in container["postCreateCommand"]
    updates = yaml.safe_load((ROOT / ".github" / "dependabot.yml").read_text(encoding="utf-8"))["updates"]
    assert {update["package-ecosystem"] for update in updates} == {"github-actions", "pip"}
    hooks = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"][0]["hooks"]
    assert all(hook["entry"].startswith(".venv/bin/") for hook in hooks)
