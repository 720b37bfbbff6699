"""A verb of verbs, to which other packages add theirs; and verbs that are loaded when they are called."""

from __future__ import annotations

from importlib import import_module

import click

from ..base.extensions import brought, declared, is_own, plugins
from ..base.figures import nearest


class Later(click.Command):
    """A verb in its place in the help, whose module is loaded when it is called.

    ``place`` is its module and its name in it; ``group`` the heading under which ``sherkit --help`` says ``said``, and
    ``at`` its place there; ``examples`` are lines that can be typed as they stand, with which its own help ends.
    """

    def __init__(self, place: str, group: str, said: str, *examples: str, at: int = 0) -> None:
        super().__init__(None, short_help=said)
        self.place, self.group, self.examples, self.at = place, group, examples, at

    def loaded(self) -> click.Command:
        """The verb itself."""
        module, _, name = self.place.partition(":")
        command: click.Command = getattr(import_module(module), name)
        command.epilog = examples(*self.examples) if self.examples else None
        return command


class OpenGroup(click.Group):
    """Its own commands first. A name that is none is answered with the nearest, which click does only for commands that
    it holds already, and not in every release."""

    #: Under which entry points other packages, and folders of sherkit that it works without, declare theirs.
    declared = ""
    #: What one of them is called, with a space behind it.
    called = ""

    @property
    def brought(self) -> dict[str, click.Command]:
        """Those that are declared, loaded now."""
        return plugins(self.commands, self.declared, click.Command)

    def list_commands(self, ctx: click.Context) -> list[str]:
        # names of sherkit's own are known without what they lead to, which would take a second to load
        own = [name for name in declared(self.declared) if is_own(self.declared, name)]
        return [*self.commands, *own, *self.brought_by_others]

    @property
    def brought_by_others(self) -> dict[str, click.Command]:
        """Those of other packages, loaded now."""
        return plugins(self.commands, self.declared, click.Command, others_alone=True)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        found = self.commands.get(cmd_name) or brought(self.declared, cmd_name, click.Command)
        return found.loaded() if isinstance(found, Later) else found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """A line or two each."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, help_line(command)) for name, command in {**self.commands, **self.brought}.items()]
            )

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if not name.startswith("-") and not ctx.resilient_parsing and self.get_command(ctx, name) is None:
            known = [*self.commands, *declared(self.declared)]
            raise click.UsageError(f"there is no {self.called}'{name}'{nearest(name, known)}", ctx)
        return super().resolve_command(ctx, args)


def examples(*lines: str) -> str:
    """What a help ends with: lines that can be typed as they stand."""
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in lines)])


def help_line(command: click.Command) -> str:
    """What a command of another package says of itself in a line; one that cannot takes no help with it."""
    try:
        return command.get_short_help_str(80)
    except Exception as error:
        return f"(its help fails: {type(error).__name__})"
