"""Values that draw themselves in a notebook."""

from __future__ import annotations


class Shown:
    """A value with a picture: IPython asks for it; where ``sherkit[view]`` is not installed the plain text stands."""

    def _repr_html_(self) -> str | None:
        # the one look upwards: what draws stands on the highest floor and is loaded when a notebook asks for it
        try:
            from .report.notebook import cell
        except ModuleNotFoundError:
            return None
        return cell(self)
