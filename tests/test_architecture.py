"""Limits on the sizes of files, folders and functions, and on cycles between modules.

The command `make lint` checks the order of the packages with import-linter. The contracts are in pyproject.toml.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCES = ("fourd", "viewer", "csrc", "tests", "tools")
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_FOLDER_FILES = 14


def test_files_are_short() -> None:
    """Catches a file with too many lines."""
    suffixes = {".py", ".cpp", ".h", ".cu", ".inc", ".cuh", ".js"}
    lengths = {path: len(path.read_text().splitlines()) for path in source_files() if path.suffix in suffixes}
    assert not {name(path): lines for path, lines in lengths.items() if lines > MAX_FILE_LINES}


def test_folders_are_small() -> None:
    """Catches a folder with too many files, which are probably unrelated."""
    counts: dict[str, int] = {}
    for path in source_files():
        counts[name(path.parent)] = counts.get(name(path.parent), 0) + 1
    assert not {folder: count for folder, count in counts.items() if count > MAX_FOLDER_FILES}


def test_functions_are_short() -> None:
    """Catches a long Python function, which probably does several things."""
    lengths = {
        f"{name(path)}:{node.name}": (node.end_lineno or node.lineno) - node.lineno + 1
        for path in source_files()
        if path.suffix == ".py"
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    assert not {function: lines for function, lines in lengths.items() if lines > MAX_FUNCTION_LINES}


def test_modules_do_not_import_each_other_in_a_cycle() -> None:
    """Catches cyclic imports between modules. Modules in a cycle cannot be read, tested or moved separately."""
    modules = package_modules()
    graph = {module: set(imports_of(path, module, modules)) for module, path in modules.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError(" <- ".join(error.args[1])) from None


def test_the_cycle_check_finds_cycles(tmp_path: Path) -> None:
    """Catches a cycle check that passes because it resolves no import."""
    one, two = tmp_path / "one.py", tmp_path / "two.py"
    one.write_text("def f():\n    from fourd import two\n    return two\n")
    two.write_text("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from fourd.one import f\n")
    modules = {"fourd": tmp_path / "__init__.py", "fourd.one": one, "fourd.two": two}
    assert list(imports_of(one, "fourd.one", modules)) == ["fourd.two"]
    assert list(imports_of(two, "fourd.two", modules)) == []


def source_files() -> Iterator[Path]:
    """The files in the folders of SOURCES, without symbolic links: fourd/viewer is a link to viewer/."""
    for top in SOURCES:
        for path in sorted((ROOT / top).rglob("*")):
            folders = path.relative_to(ROOT).parts[:-1]
            is_link = any(ROOT.joinpath(*folders[: depth + 1]).is_symlink() for depth in range(len(folders)))
            is_generated = "__pycache__" in folders or "node_modules" in folders or path.suffix in {".so", ".pyd"}
            if path.is_file() and not is_link and not is_generated:
                yield path


def package_modules() -> dict[str, Path]:
    """Map the dotted name of each module of the package `fourd` to its file."""
    modules = {}
    for path in source_files():
        parts = path.relative_to(ROOT).with_suffix("").parts
        if path.suffix == ".py" and parts[0] in {"fourd", "viewer"}:
            parts = parts if parts[0] == "fourd" else ("fourd", *parts)
            modules[".".join(parts).removesuffix(".__init__")] = path
    return modules


def imports_of(path: Path, module: str, modules: dict[str, Path]) -> Iterator[str]:
    """Modules of the package that a file imports in any line, except imports for type checkers only."""
    pending: list[ast.AST] = [ast.parse(path.read_text())]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            pending.extend(node.orelse)
            continue
        pending.extend(ast.iter_child_nodes(node))
        imported: list[str] = []
        if isinstance(node, ast.Import):
            imported = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            imported = [full if full in modules else str(node.module) for full in names]
        yield from (target for target in imported if target in modules and target != module)


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()
