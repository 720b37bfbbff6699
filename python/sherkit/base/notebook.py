"""Values that people keep and show: copied by what they were made of, drawn in a notebook."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar

# -- Saved -------------------------------------------------------------------------------------------------------------
# Values that are copied, pickled and sent to other processes by what they were made of.


class Saved:
    """A value that remembers what was computed from it, such as compiled parts, and leaves that out of its copies:
    there it is computed again when it is asked for."""

    def __getstate__(self) -> dict[str, Any]:
        made = {k: v for k, v in vars(self).items() if not isinstance(getattr(type(self), k, None), cached_property)}
        return {k: v for k, v in made.items() if not k.startswith("_last_")}


# -- Notebook ----------------------------------------------------------------------------------------------------------


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
