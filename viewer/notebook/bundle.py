"""Joins the JavaScript modules of the player to one module.

A widget is one text, which has no address, so that its code can neither import other files nor start workers from
them. The modules of viewer/web use only a small part of the syntax of imports and exports, for which no bundler written
in JavaScript is needed. Other syntax is an error.
"""

from __future__ import annotations

import json
import posixpath
import re
from collections.abc import Mapping
from pathlib import Path

_IMPORT = re.compile(r'^import (?:\{([^}]*)\} from )?"(\.[^"]*)";$', re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:async )?function\*?|class|const) (\w+)", re.MULTILINE)
_URL = re.compile(r'new URL\("(\.[^"]*)", import\.meta\.url\)')
_MODULE_WORDS = re.compile(r"^(?:import|export)\b.*|.*\bimport\.meta\b.*", re.MULTILINE)
_COMMENTS = re.compile(r"^[ \t]*/\*\*(?:(?!\*/).)*\*/[ \t]*\n|^[ \t]*//[^\n]*\n", re.MULTILINE | re.DOTALL)
_URLS = """const texts = %s, urls = {};
const urlOf = (name) => (urls[name] ??= URL.createObjectURL(new Blob([texts[name]], { type: "text/javascript" })));
"""


def bundle(root: Path, entry: str, default: str | None, files: Mapping[str, str]) -> str:
    """Return one module that does what the module ``entry`` does. Comments are left out.

    Args:
        root: folder of the modules.
        entry: path of the first module, relative to ``root``, with "/" between names.
        default: name of the export of ``entry`` that becomes the default export, or None.
        files: contents of files to which modules refer with ``new URL("...", import.meta.url)``, by their paths
            relative to ``root``. A path that ends with ".js" and is not in ``files`` names a worker, which is a module
            of ``root``.

    Raises:
        ValueError: if a module uses other syntax than the rest of the player, imports itself indirectly, or is missing.
    """
    modules = _Modules(root, dict(files))
    name = modules.add(entry)
    urls = _URLS % json.dumps(modules.texts, ensure_ascii=False) if modules.texts else ""
    end = "" if default is None else f"export default {name}.{default};\n"
    return urls + "".join(modules.parts) + end


class _Modules:
    """The modules of one bundle, each as a function that returns its exports, after the modules that it imports."""

    def __init__(self, root: Path, files: Mapping[str, str]) -> None:
        self._root = root
        self._files = files
        self._names: dict[str, str] = {}
        self._pending: list[str] = []
        self.parts: list[str] = []
        self.texts: dict[str, str] = {}

    def add(self, path: str) -> str:
        """Add a module and those that it imports. Returns the name of the variable with its exports."""
        if path in self._names:
            return self._names[path]
        if path in self._pending:
            raise ValueError(f"{path}: expected no cycle of imports, got {' -> '.join([*self._pending, path])}")
        if not (self._root / path).is_file():
            raise ValueError(f"{path}: expected a module in {self._root}, got none")
        self._pending.append(path)
        text = _COMMENTS.sub("", (self._root / path).read_text(encoding="utf-8"))
        text = _IMPORT.sub(lambda match: self._import(path, match), text)
        exports = [match[2] for match in _EXPORT.finditer(text)]
        text = _URL.sub(lambda match: self._url(path, match[1]), _EXPORT.sub(r"\1 \2", text))
        if (left := _MODULE_WORDS.search(text)) is not None:
            raise ValueError(f"{path}: expected imports and exports by name, got '{left[0].strip()}'")
        self._pending.pop()
        name = self._names[path] = f"module{len(self._names)}"
        self.parts.append(f"const {name} = (() => {{\n{text}return {{ {', '.join(exports)} }};\n}})();\n")
        return name

    def _import(self, path: str, match: re.Match[str]) -> str:
        if match[1] is None:
            self.add(_relative(path, match[2]))
            return ""
        names = match[1].replace(" as ", ": ")
        return f"const {{{names}}} = {self.add(_relative(path, match[2]))};"

    def _url(self, path: str, target: str) -> str:
        """Return the expression for the address of a file or of a worker, whose text becomes a part of the bundle."""
        name = _relative(path, target)
        if name not in self.texts:
            self.texts[name] = self._files[name] if name in self._files else bundle(self._root, name, None, self._files)
        return f"new URL(urlOf({json.dumps(name)}))"


def _relative(path: str, target: str) -> str:
    return posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
