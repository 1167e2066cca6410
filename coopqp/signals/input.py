"""A value that arrives from outside while the arms move, tick by tick.

The scenario's key ``inputs`` says how fast what follows it may go, when it is stale and what is to
be done then (``scenario.input``). What the task follows is the limited value, which the loop
keeps in ``state.inputs``; where nothing can arrive, it stays where it begins.
"""

from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array, spec
from coopqp.signal import Instant, Kind, Signal, Trajectory


@spec
class Input(Signal):
    """A value that arrives from outside, by the name that it has under the key inputs."""

    name: Annotated[str, Field(min_length=1)]
    """Of the input."""
    start: list[float] | None = None
    """Where it is before anything arrives; where nothing has to move for it if omitted."""

    @model_validator(mode="before")
    @classmethod
    def _name_alone(cls, value: Any) -> Any:
        """Lets it be spelled ``input: target``."""
        return {"name": value} if isinstance(value, str) else value

    def bind(self, kind: Kind, start: Instant, here: Array | None) -> Trajectory:
        if self.start is not None:
            try:
                here = kind.read(self.start)
            except InvalidValueError as error:
                raise InvalidValueError(f"input.start: {error}") from None
        now = start.inputs.want(self.name, kind, here)
        if now is not None:
            return _Arrived(kind, now.value, self.name)
        return _Arrived(kind, kind.zero if here is None else here, self.name)


class _Arrived(Trajectory):
    """What the loop has made of what arrived."""

    moves = True

    def __init__(self, kind: Kind, value: Array, name: str) -> None:
        super().__init__(kind, value)
        self.arrives = name

    def update(self, at: Instant) -> None:
        now = at.inputs.get(self.arrives)
        if now is not None:
            np.copyto(self.value, now.value)
            np.copyto(self.rate, now.rate)
