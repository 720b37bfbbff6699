"""A verb of verbs, to which other packages add theirs."""

from __future__ import annotations

from collections.abc import Collection

import click

from ..base.extensions import brought_beside
from ..base.names import nearest


class OpenGroup(click.Group):
    """Its own commands first. A name that is none is answered with the nearest, which click does only for commands that
    it holds already, and not in every release."""

    #: Under which entry points other packages declare theirs.
    declared = ""

    @property
    def own(self) -> Collection[str]:
        """Names that no other package can take."""
        return self.commands

    @property
    def brought(self) -> dict[str, click.Command]:
        """Those of other packages, loaded now."""
        return brought_beside(self.own, self.declared, click.Command)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*self.own, *self.brought]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return self.commands.get(cmd_name) or self.brought.get(cmd_name)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if not name.startswith("-") and not ctx.resilient_parsing and self.get_command(ctx, name) is None:
            raise click.UsageError(f"there is no '{name}'{nearest(name, self.list_commands(ctx))}", ctx)
        return super().resolve_command(ctx, args)


def told(command: click.Command) -> str:
    """What a command of another package says of itself in a line; one that cannot takes no help with it."""
    try:
        return command.get_short_help_str(80)
    except Exception as error:
        return f"(its help fails: {type(error).__name__})"
