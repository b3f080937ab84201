"""Joining the player's modules to one module."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from fourd.viewer.notebook.bundle import bundle

MODULES = {
    "main.js": """
import { Ring, area } from "./shapes/ring.js";
import { PI as pi } from "./numbers.js";
import "./side_effect.js";
/** @type {number} */
// comment
const worker = new URL("./work/worker.js", import.meta.url);
const table = new URL("./table.json", import.meta.url);
export const answer = {
  area: area(new Ring(2)), pi, seen: globalThis.seen, worker: worker.protocol,
  table: await_(table),
};
function await_(url) { return url.protocol; }
""",
    "shapes/ring.js": """
import { PI } from "../numbers.js";
export class Ring { constructor(radius) { this.radius = radius; } }
export function area(ring) { return PI * ring.radius ** 2; }
""",
    "numbers.js": "export const PI = 3;\nglobalThis.evaluated = (globalThis.evaluated ?? 0) + 1;\n",
    "side_effect.js": "globalThis.seen = 'yes';\n",
    "work/worker.js": 'import { PI } from "../numbers.js";\nself.onmessage = () => self.postMessage(PI);\n',
}


def write(folder: Path, modules: dict[str, str]) -> Path:
    for name, text in modules.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.skipif(shutil.which("node") is None, reason="no node here")
def test_a_bundle_does_what_its_modules_do(tmp_path: Path) -> None:
    """Catches a module that is evaluated twice, exports under wrong names, and workers without their imports."""
    text = bundle(write(tmp_path, MODULES), "main.js", "answer", {"table.json": "[]"})
    (tmp_path / "bundle.mjs").write_text(text)
    script = "const {default: answer} = await import(process.argv[1]);"
    script += "console.log(JSON.stringify({...answer, evaluated: globalThis.evaluated}));"
    words = ["node", "--input-type=module", "-e", script, (tmp_path / "bundle.mjs").as_uri()]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    expected = {"area": 12, "pi": 3, "seen": "yes", "worker": "blob:", "table": "blob:", "evaluated": 1}
    assert json.loads(done.stdout) == expected
    assert "comment" not in text
    assert "import {" not in text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('import * as all from "./numbers.js";\n', "got 'import \\* as all"),
        ('import three from "three";\n', "got 'import three"),
        ("export let count = 0;\n", "got 'export let count = 0;'"),
        ("const url = import.meta.url;\n", "got 'const url = import.meta.url;'"),
        ('import { a } from "./missing.js";\n', "missing.js: expected a module"),
        ('import { b } from "./b.js";\nexport const a = 1;\n', "main.js -> b.js -> main.js"),
    ],
)
def test_other_syntax_is_an_error(tmp_path: Path, text: str, message: str) -> None:
    """Catches a bundle that would fail in the page, after a change of the player that uses other syntax."""
    modules = {"numbers.js": "", "b.js": 'import { a } from "./main.js";\nexport const b = a;\n', "main.js": text}
    with pytest.raises(ValueError, match=message):
        bundle(write(tmp_path, modules), "main.js", None, {})
