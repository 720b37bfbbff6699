"""Lines that a person types into the page: tried, kept in the folder of the study, and run apart from it."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

from ..base.names import listed
from ..data.files import write_whole
from ..errors import EffectError
from ..model.effect import Effect
from ..study import Study
from .sandbox import PATIENCE_S, Sandbox


class Typed:
    """The lines of one study, at ``path``. ``look`` is called while they run; what it raises ends them."""

    def __init__(self, path: Path, patience_s: float = PATIENCE_S) -> None:
        self.path = path
        self.look: Callable[[], None] = lambda: None
        self._patience_s = patience_s
        #: Effects of older lines, which a step that is undone may bring back, and of those that are kept.
        self._sandbox: list[Sandbox] = []
        self._names: frozenset[str] = frozenset()

    @property
    def state(self) -> frozenset[str]:
        """What :meth:`restore` needs where a change did not happen."""
        return self._names

    def restore(self, state: frozenset[str]) -> None:
        """Back to an earlier state."""
        self._names = state

    def again(self) -> tuple[Effect, ...]:
        """Runs the lines that are kept, if there are any."""
        if not self.path.exists():
            return ()
        return self._kept(self._begun(self.path.read_text(encoding="utf-8")))

    def run(self, source: str, study: Study) -> None:
        """Runs lines, makes their effects known to the study, and keeps them.

        Raises :class:`~sherkit.errors.EffectError`, with lines and effects as they were before.
        """
        trial = self.path.with_name(f"next.{self.path.name}")
        write_whole(trial, source)
        known = dict(study.own)
        used = self._names & set(study.effects)
        made: Sandbox | None = None
        try:
            if used and not _contains(source, self.path.read_text(encoding="utf-8")):
                # the model would go on with the old lines, and the study come back with the new ones
                raise EffectError(
                    f"{listed(sorted(used))} is in the model: remove it before you change its lines; you can add to "
                    "them"
                )
            made = self._begun(source)
            for effect in made.effects:
                if effect.name not in used:
                    study.register(effect)
        except BaseException:
            if made is not None:
                made.end()
            study.own = known
            trial.unlink()
            raise
        trial.replace(self.path)
        self._kept(made)

    def _begun(self, source: str) -> Sandbox:
        return Sandbox(source, lambda: self.look(), self._patience_s)

    def _kept(self, made: Sandbox) -> tuple[Effect, ...]:
        self.end()  # those that are asked again begin again, with their own lines
        self._sandbox.append(made)
        self._names = frozenset(e.name for e in made.effects)
        return made.effects

    def forgive(self) -> None:
        """Asks lines again that were ended."""
        for one in self._sandbox:
            one.forgive()

    def end(self) -> None:
        """Ends what runs."""
        for one in self._sandbox:
            one.end()


def _contains(source: str, old: str) -> bool:
    """Whether every statement of the old lines is in the new ones, comments and spaces aside."""
    return {ast.dump(s) for s in _statements(old)} <= {ast.dump(s) for s in _statements(source)}


def _statements(source: str) -> list[ast.stmt]:
    try:
        return ast.parse(source).body
    except (SyntaxError, ValueError) as error:
        raise EffectError(f"your lines: {type(error).__name__}: {error}") from None
