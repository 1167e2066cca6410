"""Which internal wrenches motors command: the notes' table, and ranks of a whole dynamics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from chains import Hinge, heavy, planar_pair, ring, short_pair, spherical_pair, three_arms
from scenario_files import LOADABLE

import coopqp
from coopqp.base.spec import Array
from coopqp.closed_loop.hands import hands, points
from coopqp.closed_loop.transmission import LENGTH, transmission
from coopqp.grasps import Spherical
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State

#: Scenario: dimensions; commanded, borne, not transmitted; least singular value at the start.
TABLE = {
    "point_on_point": (6, (6, 0, 0), 0.041),
    "passive_grasp_pose": (6, (4, 0, 2), 0.050),
    "two_pandas": (6, (6, 0, 0), 0.156),
    "baxter_tray": (6, (6, 0, 0), 0.146),
    "tiago_torso": (6, (6, 0, 0), 0.119),
    "three_ur": (12, (12, 0, 0), 0.077),
    "planar_pair": (6, (3, 3, 0), 0.124),
    "yeo_4_5": (6, (5, 0, 1), 0.076),
}


def ball_and_hinge() -> ClosedChain:
    """Two small arms of seven joints, one with a ball in its hand, the other with a hinge."""
    firm = ring(2, 7)
    grasps = {"a": Spherical(), "b": Hinge()}
    q = firm.q_start[: firm.robot.model.nq]
    return ClosedChain.attach(firm.robot, q, grasps, HeldObject())


#: Robots of no scenario, all with masses.
OWN: dict[str, Callable[[], ClosedChain]] = {
    "planar": lambda: heavy(planar_pair()),
    "spherical": lambda: heavy(spherical_pair()),
    "short": lambda: heavy(short_pair()),
    "three arms": three_arms,
    "ball and hinge": ball_and_hinge,
    "four arms": lambda: ring(4, 5),
}


@pytest.mark.parametrize("name", [name for name in TABLE if name in LOADABLE])
def test_the_table_of_the_notes(name: str) -> None:
    chain = coopqp.load(name).chain
    found, (dimensions, counts, weakest) = transmission(chain, chain.q_start), TABLE[name]
    assert found.dimensions == dimensions
    assert (found.all.commanded, found.all.structure, found.all.let_go) == counts
    assert found.all.weakest == pytest.approx(weakest, abs=6e-4)


def by_dynamics(chain: ClosedChain) -> tuple[int, int, int]:
    """The ranks from a dynamics in which object and hands are bodies of their own.

    Unknown: the joints' and the object's accelerations and the hands' wrenches. Torques that
    accelerate nothing bring about internal wrenches; wrenches that neither joints nor object feel
    are the structure's; the rest can be told by no torque at rest.
    """
    n, N = chain.n, chain.holding
    J = chain.object_jacobians(chain.q_start)[:N].copy()
    J[:, 3:] *= LENGTH  # all six rows as lengths, all wrenches as forces
    A = np.asarray(pin.crba(chain.model, chain.model.createData(), chain.q_start))
    A = A + 1e-3 * np.eye(n)  # what is behind a passive joint has no mass
    feels, G = J.reshape(6 * N, n), np.tile(np.eye(6), (1, N))
    K = np.block(
        [
            [A, np.zeros((n, 6)), feels.T],
            [np.zeros((6, n)), np.eye(6), -G],
            [feels, -G.T, np.zeros((6 * N, 6 * N))],
        ]
    )
    motors = np.setdiff1d(np.arange(n), chain.passive)
    answer = np.linalg.pinv(K, rcond=1e-9)[:, motors]
    _, values, Vt = np.linalg.svd(answer[: n + 6])
    still = Vt[int(np.sum(values > 1e-9)) :].T
    commanded = np.linalg.matrix_rank(answer[n + 6 :] @ still, tol=1e-6) if still.size else 0
    unfelt = np.linalg.svd(np.hstack([feels, G.T]).T, compute_uv=False)
    structure = 6 * N - int(np.sum(unfelt > 1e-7))
    return int(commanded), structure, 6 * (N - 1) - int(commanded) - structure


@pytest.mark.parametrize("name", OWN)
def test_ranks_agree_with_a_dynamics_of_free_bodies(name: str) -> None:
    chain = OWN[name]()
    found = transmission(chain, chain.q_start)
    assert (found.all.commanded, found.all.structure, found.all.let_go) == by_dynamics(chain)
    assert len(found.arms) == chain.holding
    assert len(found.pairs) == chain.holding * (chain.holding - 1) // 2


def test_planar_arms_command_what_is_in_their_plane() -> None:
    (pair,) = transmission(planar_pair(), planar_pair().q_start).pairs
    assert pair.components == {
        "squeeze": "commanded",
        "shear_up": "structure",
        "shear_side": "commanded",
        "twist": "structure",
        "bend_up": "commanded",
        "bend_side": "structure",
    }


def test_an_arm_of_nao_bears_a_force_along_the_line_from_shoulder_to_elbow(
    chain: ClosedChain,
) -> None:
    """All five axes meet that line, so that no motor feels it; of the pair nothing is borne."""
    model, data = chain.model, chain.model.createData()
    pin.forwardKinematics(model, data, chain.q_start)
    found = transmission(chain, chain.q_start)
    for arm, side in zip(found.arms, "RL", strict=True):
        (borne,) = arm.borne
        shoulder, elbow = (
            data.oMi[model.getJointId(f"{side}{joint}")].translation
            for joint in ("ShoulderPitch", "ElbowRoll")
        )
        way = (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
        assert abs(way @ np.array(borne.axis)) == pytest.approx(1.0)
        assert np.linalg.norm(np.cross(shoulder - np.array(borne.point), way)) < 1e-9
        assert abs(borne.pitch) < 1e-9
        assert borne.describe_force().startswith("force along (")
    assert found.pairs[0].counts.summary == (
        "6 commanded, 0 borne by the structure, 0 not transmitted"
    )


def test_no_component_alone_is_free_of_naos_hinges() -> None:
    chain = coopqp.load("passive_grasp_pose").chain
    (pair,) = transmission(chain, chain.q_start).pairs
    assert set(pair.components.values()) == {"not alone"}


def test_the_hands_are_where_their_tips_are(chain: ClosedChain) -> None:
    state, data = State(chain), chain.model.createData()
    pin.framesForwardKinematics(chain.model, data, chain.q_start)
    tips = [data.oMf[chain.model.getFrameId(arm.tip)].translation for arm in chain.arms]
    found: Array = points(hands(chain), state.p_WO, state.R_WO)
    assert np.allclose(found, tips)
