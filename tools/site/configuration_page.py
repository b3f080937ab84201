"""Generate docs/configuration.md, which lists every key of the config dataclasses with its default and its docstring.

python tools/site/configuration_page.py
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from collections.abc import Iterator
from pathlib import Path

from fourd.base.configs import to_yaml
from fourd.base.files import write_text_atomically
from fourd.reconstruction.training.config import TrainConfig

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"
HEAD = """# Configuration

The commands `fourd train` and `fourd make` read config keys from a YAML file (`--config FILE.yaml`) and from the
command line (`--set KEY=VALUE`). The option `--set` can be repeated. KEY is a path with dots, such as
`model.planes.levels`. VALUE is written as YAML:

```
fourd train CAPTURE -o run/ --max-steps 5000 --set rates.planes=1e-3 --set model.planes.levels=3
```

The YAML file overrides the defaults that this page lists. Both `--set` and the flags of single keys, such as
`--points`, override the YAML file. A key that is given both with `--set` and with its flag is an error. An unknown key
or a value of the wrong type is also an error. The message for an unknown key names the most similar key. The folder
`configs/` has the settings of the 4K4D paper and presets for ablations. Here is an example of a config file:

```yaml
# 48 free SH coefficients per point, on smaller images
image_scale: 0.5
model:
  sh: explicit
```

This page is generated from the code by `tools/site/configuration_page.py`.
"""


def page() -> str:
    """Return the text of the page."""
    lines = [HEAD]
    for path, config in _sections("", TrainConfig()):
        notes = _notes(type(config))
        lines += [f"## {path or 'Training'}", "", _first_line(config), ""]
        lines += ["| key | default | meaning |", "|---|---|---|"]
        for item in dataclasses.fields(config):
            value = getattr(config, item.name)
            if not dataclasses.is_dataclass(value):
                lines.append(f"| `{item.name}` | `{_shown(value)}` | {notes.get(item.name, '')} |")
        lines.append("")
    return "\n".join(lines)


def _sections(path: str, config: object) -> Iterator[tuple[str, object]]:
    yield path, config
    assert dataclasses.is_dataclass(config)
    for item in dataclasses.fields(config):
        value = getattr(config, item.name)
        if dataclasses.is_dataclass(value):
            yield from _sections(f"{path}.{item.name}".lstrip("."), value)


def _notes(kind: type) -> dict[str, str]:
    """Return a mapping from each field name of a dataclass to the docstring below the field."""
    body = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(body, ast.ClassDef)
    notes = {}
    for field, note in zip(body.body, body.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(note, ast.Expr) and isinstance(note.value, ast.Constant):
            assert isinstance(field.target, ast.Name)
            notes[field.target.id] = " ".join(str(note.value.value).split())
    return notes


def _first_line(config: object) -> str:
    return (inspect.getdoc(type(config)) or "").splitlines()[0]


def _shown(value: object) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}]"
    single = dataclasses.make_dataclass("single", [("value", object)])
    return to_yaml(single(value)).removeprefix("value:").strip()


if __name__ == "__main__":
    write_text_atomically(PAGE, page())
