"""Arms, torso and object stay apart: d_dot >= -gain (d - distance) for pairs of bodies.

Bodies are the robot's capsules, or the convex parts of its file's collision geometry, and the
object's box, as carried by the first arm. With n the unit normal from the first body to the second
at their nearest points and d their signed distance,

    n' (J_first - J_second) v <= gain (d - distance)

(:mod:`coopqp.limits._bodies`, which also says which pairs are watched). A pair that is too close by
more than a millimetre may not come closer, but is not pushed back (:func:`coopqp.limit.damp`), so
that one that cannot part does not stop the robot.
"""

import itertools
from collections.abc import Collection, Iterator, Sequence

from coopqp.base.errors import InvalidValueError, under
from coopqp.base.spec import Name, spec
from coopqp.base.wording import counted
from coopqp.limits._bodies import (
    Body,
    Pair,
    bodies_of,
    by_construction,
    named_bodies,
    pairs_that_can_meet,
)
from coopqp.limits._keep_apart import KeepApart, check_count
from coopqp.model.closed_chain import ClosedChain

NamePair = tuple[str, str]

#: How many of the pairs that are left out are named in a note.
SHOWN = 3


@spec
class SelfCollision(KeepApart):
    """Arms, torso and object keep a distance from each other."""

    name: Name = "self_collision"
    """Your name for it in rows and tables; give it when there are several."""
    pairs: tuple[NamePair, ...] | None = None
    """Names of bodies, patterns such as *finger*, or "object"; those that can meet if omitted."""
    ignore: tuple[NamePair, ...] = ()
    """Pairs that are not watched, in the same words."""

    def __post_init__(self) -> None:
        seen: set[frozenset[str]] = set()
        for pair in self.pairs or ():
            one = frozenset(pair)
            if one in seen or (len(one) < 2 and not set(pair[0]) & set("*?[")):
                raise ValueError(f"pair {list(pair)} names one body, or a pair given before")
            seen.add(one)
        KeepApart.__post_init__(self)

    def start_faults(self, chain: ClosedChain) -> tuple[str, ...]:
        found = self.inside(chain)
        if not found:
            return ()
        depths = ", ".join(f"{a.name} and {b.name} {1e3 * depth:.1f} mm" for a, b, depth in found)
        pairs = ", ".join(f"[{a.name}, {b.name}]" for a, b, _ in found)
        return (
            f"{self.name}: bodies start in each other, {depths}; move them apart, or if they "
            f"always are, add 'ignore: [{pairs}]'",
        )

    def notes(self, chain: ClosedChain) -> tuple[str, ...]:
        """What is not watched: parts that are no bodies, and pairs that touch by construction."""
        at_start, found = self.at_start(chain), [*self.unseen(chain)]
        if not at_start:
            found.append(f"{self.name} watches nothing: no two bodies can meet")
        found += self.nearer(at_start)
        joined = sorted(" and ".join(sorted(pair)) for pair in by_construction(chain.robot))
        if joined and self.pairs is None:
            shown = ", ".join(joined[:SHOWN]) + (", ..." if len(joined) > SHOWN else "")
            found.append(
                f"{self.name} leaves out {counted(len(joined), 'pair')} that "
                f"{'touch' if len(joined) > 1 else 'touches'} by construction ({shown})"
            )
        return tuple(found)

    def watched(self, chain: ClosedChain) -> list[Pair]:
        """Those given, or those that can meet, without those to be ignored."""
        bodies, faults = bodies_of(chain)
        if self.pairs is None:
            found = pairs_that_can_meet(chain)
        else:
            found = list(_named(self.name, "pairs", self.pairs, bodies, faults))
            if not found:
                raise InvalidValueError(
                    f"{self.name}.pairs: these bodies are fixed to each other"
                ).at("pairs")
        ignored = {
            _names(pair) for pair in _named(self.name, "ignore", self.ignore, bodies, faults)
        }
        kept = [pair for pair in found if _names(pair) not in ignored]
        if found and not kept:
            raise InvalidValueError(
                f"{self.name}.ignore: leaves no pair to watch; name fewer, or leave the limit out"
            ).at("ignore")
        check_count(self.name, len(kept))
        return kept


def _names(pair: Pair) -> frozenset[str]:
    return frozenset(body.name for body in pair)


def _named(
    owner: str, key: str, names: Collection[NamePair], bodies: Sequence[Body], faults: Sequence[str]
) -> Iterator[Pair]:
    """Pairs of bodies by names and patterns, each once; errors as :func:`named_bodies`."""
    seen = set[frozenset[Body]]()
    where = f"{owner}.{key}: "
    for i, pair_of_names in enumerate(names):
        with under(key, i):
            ones, others = (named_bodies(where, name, bodies, faults) for name in pair_of_names)
        for pair in itertools.product(ones, others):
            if pair[0].joint != pair[1].joint and frozenset(pair) not in seen:
                seen.add(frozenset(pair))
                yield pair
