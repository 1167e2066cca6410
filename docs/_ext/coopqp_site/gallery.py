"""In which order the gallery shows its scripts."""

from __future__ import annotations

from typing import Any

#: What comes first; all others follow by name.
FIRST = ("the_papers_system", "tilting_plane", "joint_limits", "singular_pose", "your_own_task")


class Order:
    """A key to sort by; the folder does not matter."""

    def __init__(self, folder: Any) -> None:
        pass

    def __call__(self, file: str) -> tuple[int, str]:
        """Of a script's file name."""
        name = file.removesuffix(".py")
        return (FIRST.index(name) if name in FIRST else len(FIRST)), name

    def __repr__(self) -> str:
        """The same in every build, so that nothing is built again for it."""
        return "Order"
