"""``sherkit completion``: the tab key, in bash, zsh and fish."""

from __future__ import annotations

import os
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from ..errors import SherkitError

_SHELLS = ("bash", "zsh", "fish")
_VARIABLE = "_SHERKIT_COMPLETE"


@click.command()
@click.argument("shell", type=click.Choice(_SHELLS), required=False)
def completion(shell: str | None) -> None:
    """Print what completes verbs, options and files with the tab key; by default for the SHELL that runs.

    \b
    eval "$(sherkit completion bash)"                                   # in ~/.bashrc
    eval "$(sherkit completion zsh)"                                    # in ~/.zshrc
    sherkit completion fish > ~/.config/fish/completions/sherkit.fish
    """
    name = shell or Path(os.environ.get("SHELL", "")).name
    made = get_completion_class(name) if name in _SHELLS else None
    if made is None:
        raise SherkitError(f"which shell runs cannot be told ('{name}'); expected sherkit completion bash, zsh or fish")
    root = click.get_current_context().find_root()
    print(made(root.command, {}, "sherkit", _VARIABLE).source())
