"""Values that draw themselves in a notebook."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar


class Shown:
    """A value with a picture: IPython asks for it; where nothing that draws is installed the plain text stands.

    ``draw`` gives the HTML of a value, or None; the package's door fills it, so that no value knows of pictures. The
    floors that draw know those above them; who brings a value of another sort names in ``drawn_by`` the module and the
    function that give its pictures.
    """

    drawn_by: ClassVar[str] = ""

    draw: ClassVar[Callable[[Any], str | None] | None] = None

    def _repr_html_(self) -> str | None:
        draw = Shown.draw
        return None if draw is None else draw(self)
