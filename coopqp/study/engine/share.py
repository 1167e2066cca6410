"""Which of the items a command does, where several commands share them: ``--shard 2/8``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from coopqp.base.errors import InvalidValueError

Item = TypeVar("Item")

#: Commands that may share a job; job arrays of clusters have fewer.
MOST = 100_000


@dataclass(frozen=True)
class Share:
    """Every so manyeth item.

    Attributes:
        number: which share, from 1 on.
        of: in how many.
    """

    number: int = 1
    of: int = 1

    @classmethod
    def read(cls, text: str) -> Share:
        """From what is written, such as "2/8".

        Raises:
            InvalidValueError: that is none.
        """
        found = re.fullmatch(r"\s*(\d{1,6})\s*/\s*(\d{1,6})\s*", text)
        number, of = (int(part) for part in found.groups()) if found else (0, 0)
        if not 1 <= number <= of <= MOST:
            raise InvalidValueError(f"--shard: found '{text}', needs I/N such as 2/8, I of 1 to N")
        return cls(number, of)

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @property
    def whole(self) -> bool:
        """Whether it is all there is."""
        return self.of == 1

    def taken(self, items: Sequence[Item]) -> Sequence[Item]:
        """The items of this share."""
        return items[self.number - 1 :: self.of]
