"""Commands that a verb proposes, as they can be typed: with the files and the options that it was given itself."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

import click
from click.core import ParameterSource

from ..base.answer import FILES
from .paths import OutputFile, OutputFolder

#: Where options that no function is given keep what was typed.
KEPT = "sherkit.typed"
#: The file of effects that a proposed command writes.
_OWN = "my_effects.py"
#: Options that say how an answer is shown, not what is asked.
_SHOWN = ("--json", "--checks", "--help")


def completed(command: str, files: str = "") -> str:
    """A proposed command with ``files`` (quoted) in their place, and every option that was typed and that its verb
    takes as well."""
    whole = command.replace(FILES, files) if files else command
    ctx = click.get_current_context(silent=True)
    words = shlex.split(command)
    if ctx is None or len(words) < 2:
        return whole
    root = ctx.find_root()
    verb = root.command.get_command(root, words[1]) if isinstance(root.command, click.Group) else None
    takes = {name for one in (verb.params if verb is not None else ()) for name in one.opts}
    every = list(_typed(ctx))
    if ("--effects", _OWN) in every:
        # what is read is not written over
        whole = whole.replace(f"--template {_OWN}", f"--template more_{_OWN}")
    for typed in every:
        name, *value = typed
        there = name in words and (not _repeats(verb, name) or [name, *value] in map(list, pairwise(words)))
        if name not in takes or there:
            continue
        whole += f" {shlex.join(typed)}"
    return whole


def in_json(told: Any, files: str) -> Any:
    """What a program reads, with its commands :func:`completed`."""
    if isinstance(told, Mapping):
        return {
            key: completed(one, files) if key == "command" and isinstance(one, str) and one else in_json(one, files)
            for key, one in told.items()
        }
    return [in_json(one, files) for one in told] if isinstance(told, list | tuple) else told


def _repeats(verb: click.Command | None, name: str) -> bool:
    """Whether an option may be given more than once."""
    own = next((one for one in (verb.params if verb is not None else ()) if name in one.opts), None)
    return isinstance(own, click.Option) and own.multiple


def _typed(ctx: click.Context) -> Iterator[tuple[str, ...]]:
    """The options that were typed, each as it stands on a command line; not what is written, nor how it is shown."""
    kept: Mapping[str, str] = ctx.meta.get(KEPT, {})
    for one in ctx.command.params:
        if not isinstance(one, click.Option) or one.name is None or isinstance(one.type, OutputFile | OutputFolder):
            continue
        name = max(one.opts, key=len)
        if name in _SHOWN or ctx.get_parameter_source(one.name) is not ParameterSource.COMMANDLINE:
            continue
        value: Any = ctx.params.get(one.name, kept.get(one.name))
        if one.is_flag:
            yield (name,) if value else (min(one.secondary_opts, key=len, default=name),)
        else:
            every: tuple[Any, ...] = tuple(value) if one.multiple else (value,)
            for each in every:
                yield name, str(each)
