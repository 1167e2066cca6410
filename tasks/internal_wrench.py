"""The internal wrench between two hands through the object: squeeze, shear, twist, bend.

    C h = wanted

h (6 N,) are the hands' wrenches on the object at their points, and C has a row for each component
given; all others are free. They are those of the section wrench at the middle between the hands
(``closed_loop.grasp_matrix``), with equal shares Walker's internal wrench; between three hands
only the push along their edge, by the virtual linkage. The squeeze is the mean of both normal
forces, which differ by the object's weight along the line between the hands.

``torque_qp`` brings it about by torques, and ``qp`` a squeeze by admittance
(:mod:`coopqp.closed_loop.admittance`); others leave it out.
"""

from dataclasses import replace
from typing import Annotated, ClassVar

from coopqp.base.errors import GraspError, require_known, under
from coopqp.base.spec import Array, Positive, spec
from coopqp.closed_loop.grasp_matrix import COMPONENTS, UNITS, section, squeeze_rows
from coopqp.closed_loop.hands import Hand, hands, points
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.signal import Kind, Reads, Signal, trajectory_of
from coopqp.task import Evaluate, Part, Task, TaskRows

FORCE = Kind("component of a wrench", 1, columns=("value",))
Component = Annotated[float | Signal | None, Reads(float | None, FORCE)]


@spec
class InternalWrench(Task):
    """Two hands squeeze, shear, twist or bend the object so much; what is not given is free."""

    unit: ClassVar[str] = "N"
    of_forces: ClassVar[bool] = True

    arms: tuple[str, str] | None = None
    """Which two; the two that hold the object if omitted. The first is hand 1."""
    squeeze: Component = None
    """They press the object between them [N]; the mean of both."""
    shear_up: Component = None
    """Hand 1 pushes up against hand 2, across the line between them [N]."""
    shear_side: Component = None
    """It pushes sideways, along that line times up [N]."""
    twist: Component = None
    """It turns against hand 2 about the line [N m]."""
    bend_up: Component = None
    """It turns against hand 2 about up [N m]."""
    bend_side: Component = None
    """It turns against hand 2 about the other direction across the line [N m]."""
    tolerance: Positive = 1.0
    """Error of a force at the end that still counts as reached [N]."""
    tolerance_torque: Positive = 0.1
    """The same of a torque [N m]."""

    def __post_init__(self) -> None:
        if not self.components:
            raise ValueError(f"needs at least one of {', '.join(COMPONENTS)}")
        if self.mode == "scaled":
            raise ValueError("mode: a force is soft or hard, not scaled")
        if self.arms and self.arms[0] == self.arms[1]:
            raise ValueError("arms: needs two different ones")

    @property
    def components(self) -> tuple[str, ...]:
        """Those that are given, in the order of the section wrench."""
        return tuple(name for name in COMPONENTS if getattr(self, name) is not None)

    def rows(self, chain: ClosedChain) -> tuple[str, ...]:
        return self.components

    def parts(self, chain: ClosedChain) -> tuple[Part, ...]:
        units = dict(zip(COMPONENTS, UNITS, strict=True))
        torques = sum(units[name] == "N m" for name in self.components)
        force = Part("force", len(self.components) - torques, "N", self.tolerance)
        torque = Part("torque", torques, "N m", self.tolerance_torque)
        if force.rows and torque.rows:
            return force, torque
        return (replace(force if force.rows else torque, name=""),)

    def bind(self, start: State) -> Evaluate:
        """C and what is wanted, for the hands that hold the object now.

        UnknownNameError: an arm that does not hold it. GraspError: the pair is not given, three
        hands are on one line, or a component that three hands do not have.
        """
        held = hands(start.chain)
        i, j = self._pair(held)
        chosen = [COMPONENTS.index(name) for name in self.components]
        given = [getattr(self, name) for name in self.components]
        wanted = [trajectory_of(x if isinstance(x, Signal) else [x], FORCE, start) for x in given]

        def evaluate(state: State, rows: TaskRows) -> None:
            at = points(held, state.p_WO, state.R_WO)
            rows.J[:] = 0.0
            if len(held) == 2:
                found = section(at[i], at[j]).rows[chosen].reshape(-1, 2, 6)
                rows.J.reshape(-1, 2, 6)[:, [i, j]] = found
            else:
                rows.J[0] = squeeze_rows(at)[min(i, j), max(i, j)]
            for row, followed in enumerate(wanted):
                followed.update(state)
                rows.rate[row] = followed.value[0]

        self._check(points(held, start.p_WO, start.R_WO))
        return evaluate

    def _pair(self, held: tuple[Hand, ...]) -> tuple[int, int]:
        names = [hand.arm for hand in held]
        if self.arms is None:
            if len(names) < 2:
                found = "one hand holds" if names else "no hand holds"
                raise GraspError(f"{found} the object; what cancels needs two that do")
            if len(names) > 2:
                raise GraspError(
                    f"arms: {len(names)} hands hold the object; say between which two, such as "
                    f"[{', '.join(names[:2])}]"
                )
            return 0, 1
        with under("arms"):
            require_known("arm", self.arms, names, "arms: ")
        return names.index(self.arms[0]), names.index(self.arms[1])

    def _check(self, at: Array) -> None:
        if len(at) == 2:
            section(at[0], at[1])
            return
        if self.components != ("squeeze",):
            raise GraspError(
                f"between two of {len(at)} hands there is a squeeze along their edge and nothing "
                "else; leave the other components out"
            )
        if not squeeze_rows(at):
            words = "three hands are on one line" if len(at) == 3 else f"found {len(at)} hands"
            raise GraspError(f"{words}: pushes along their edges are not independent; needs two "
                             "hands, or three off one line")  # fmt: skip
