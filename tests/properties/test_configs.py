"""Configs in YAML and on the command line. Every value must be read back unchanged, or be rejected with one error."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fourd.base.configs import load_overlay, save_config, set_values, to_yaml
from fourd.base.errors import UserError
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.run import RunConfig
from fourd.scene.styles.styles import Style
from tests.properties.configs import assignments, changed_lines, configs, paths_of, values, with_value
from tests.properties.effort import EFFORTS

BASES = [RunConfig(), Style()]
ids = [type(base).__name__ for base in BASES]


@EFFORTS
@pytest.mark.parametrize("base", BASES, ids=ids)
def test_written_configs_are_read_back_equal(base: object, effort: settings, tmp_path: Path) -> None:
    """Catches a written value that the reader converts or rejects."""

    @effort
    @given(configs(base))
    def check(config: object) -> None:
        save_config(config, tmp_path / "a.yaml")
        assert load_overlay(base, tmp_path / "a.yaml") == config
        assert load_overlay(config, tmp_path / "a.yaml") == config

    check()


@EFFORTS
@pytest.mark.parametrize("base", BASES, ids=ids)
def test_changed_configs_are_read_or_refused(base: object, effort: settings, tmp_path: Path) -> None:
    """Catches exceptions other than UserError, errors without the file's name, and configs that change when they are
    written and read again.
    """

    @effort
    @given(configs(base).flatmap(lambda config: changed_lines(to_yaml(config))))
    def check(text: str) -> None:
        path = tmp_path / "a.yaml"
        path.write_text(text, encoding="utf-8")
        try:
            config = load_overlay(base, path)
        except UserError as error:
            assert str(error).startswith(str(path))  # noqa: PT017
            return
        path.write_text(to_yaml(config), encoding="utf-8")
        assert load_overlay(base, path) == config

    check()


@EFFORTS
def test_files_of_any_bytes_are_read_or_refused(effort: settings, tmp_path: Path) -> None:
    """Catches exceptions other than UserError for bytes that are not text, and for text that is not YAML."""

    @effort
    @given(st.binary(max_size=64) | st.text(max_size=64).map(lambda text: text.encode("utf-16")))
    def check(content: bytes) -> None:
        path = tmp_path / "a.yaml"
        path.write_bytes(content)
        try:
            load_overlay(TrainConfig(), path)
        except UserError as error:
            assert str(error).startswith(str(path))  # noqa: PT017

    check()


@EFFORTS
def test_assigned_values_are_used_as_they_are(effort: settings) -> None:
    """Catches a value of --set that is converted, or assigned to another key."""
    fields = list(paths_of(TrainConfig()))

    @effort
    @given(st.data())
    def check(data: st.DataObject) -> None:
        path, kind = data.draw(st.sampled_from(fields))
        value = data.draw(values(kind))
        try:
            expected = with_value(TrainConfig(), path, value)
        except ValueError:
            assume(False)
        text = yaml.safe_dump(
            {"a": list(value) if isinstance(value, tuple) else _plain(value)}, default_flow_style=True
        )
        text = text.strip().removeprefix("{a: ").removesuffix("}")
        assume("\n" not in text)
        assert set_values(TrainConfig(), [f"{'.'.join(path)}={text}"]) == expected

    check()


def _plain(value: object) -> object:
    return str(value) if isinstance(value, Path) else list(value) if isinstance(value, tuple) else value


@EFFORTS
def test_assignments_are_used_or_refused(effort: settings, tmp_path: Path) -> None:
    """Catches exceptions other than UserError, and configs from the command line that cannot be read again from the
    run.
    """

    @effort
    @given(st.lists(assignments(TrainConfig()), min_size=1, max_size=3))
    def check(texts: list[str]) -> None:
        try:
            config = set_values(TrainConfig(), texts)
        except UserError as error:
            assert str(error).startswith("--set")  # noqa: PT017
            return
        save_config(config, tmp_path / "a.yaml")
        assert load_overlay(TrainConfig(), tmp_path / "a.yaml") == config

    check()
