"""Which kinds of robot there are: sherkit's own and those of other packages, each declared in its package's
``pyproject.toml``, under ``[project.entry-points."sherkit.robots"]``."""

from ..base.extensions import ROBOTS, declared, leave_out, plugins
from ..model.kinds import Kind, register

#: Where columns fit no robot, messages speak of the first.
_FIRST = ("delta", "spherical", "serial", "printer")

_found = plugins((), ROBOTS, Kind)
for _name in sorted(_found, key=lambda one: _FIRST.index(one) if one in _FIRST else len(_FIRST)):
    _kind = _found[_name]
    if _kind.name != _name:
        # known by its own name it could take another's place
        leave_out(ROBOTS, declared(ROBOTS)[_name], f"is not used: the Kind calls itself '{_kind.name}'")
        continue
    try:
        register(_kind)
    except Exception as _error:  # a stranger's kind, whatever it raises, takes no other with it
        leave_out(ROBOTS, declared(ROBOTS)[_name], f"is not used ({type(_error).__name__}: {_error})")
