"""A Griffe extension that converts Sphinx roles in docstrings, such as :func:`render_points`, to code spans."""

from __future__ import annotations

import re
from typing import Any

from griffe import Extension, Object

ROLE = re.compile(r":(?:py:)?(?:func|class|meth|mod|attr|data|exc|obj):`~?([^`]+)`")


class SphinxRoles(Extension):
    """Converts the Sphinx roles in every docstring to code spans."""

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Convert the roles in the docstring of ``obj``, in place."""
        if obj.docstring is not None:
            text = obj.docstring.value.replace("``", "`")
            obj.docstring.value = ROLE.sub(r"`\1`", text)
