"""Which file is that of a flexible tool: asked by who loads the tool's folder only for one."""

from __future__ import annotations

import tomllib
from pathlib import Path

#: The key ``kind`` of a tool's file.
KIND = "flexible_tool"


def is_tool(path: Path) -> bool:
    """Whether a TOML file is that of a flexible tool; what cannot be read is left to its reader."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig")).get("kind") == KIND
    except (OSError, ValueError, RecursionError):
        return False
