"""A Griffe extension that converts Sphinx roles in docstrings, such as :func:`render_points`, to code spans."""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

ROLE = re.compile(r":(?:py:)?(?:func|class|meth|mod|attr|data|exc|obj):`~?([^`]+)`")


class SphinxRoles(Extension):
    """Rewrite the roles in every docstring."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Rewrite the docstring of one object in place."""
        if obj.docstring is not None:
            text = obj.docstring.value.replace("``", "`")
            obj.docstring.value = ROLE.sub(r"`\1`", text)
