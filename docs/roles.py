"""What docstrings say in Sphinx's roles, as links of the site: ``:class:`~sherkit.errors.FitError``` and its like."""

from __future__ import annotations

import re
from typing import Any

import griffe

_ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):`(~?)([^`]+)`")


def linked(text: str) -> str:
    """Each role as a code word, which links to what it names where the site has that."""

    def word(found: re.Match[str]) -> str:
        path = found[2].lstrip(".")
        shown = path.rpartition(".")[2] if found[1] else path
        return f'<autoref identifier="{path}" optional><code>{shown}</code></autoref>'

    return _ROLE.sub(word, text).replace("``", "`")


class Roles(griffe.Extension):
    """Rewrites the docstrings of everything that is loaded."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for each module, class, function and attribute."""
        if obj.docstring is not None:
            obj.docstring.value = linked(obj.docstring.value)
