"""The nodes to which the lanes come back, and how the lanes of a packet keep in step.

A lane that has followed a branch to its end goes on at its deepest pending node. If each did so at once, the first of
them whose branch is one surface shorter would be one node ahead of the others for good: neighbours would be at
different surfaces and depths most of the time, and a packet of lanes would pay for all of them. So a lane waits at a
node to which it comes back. Lanes that are back at a node behind a reflection go on together when no lane of the packet
is under way (level 1), and those that are back on the direct path when none is left that waits at level 1 (level 2).
Few lanes lose time by it, since neighbours have nearly the same trees: 2 % in a double Gauss, where nine of ten packets
are at one surface then, and three of ten without. Where light is scattered neighbours have trees of their own: waiting
would take half as long again there, and lanes go on at once.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.settings import NO_LIMIT

LEVELS = 2
# Type and count of the numbers of a node, with the names of the loop's state; recorders may read the first ones
ALWAYS: dict[str, tuple[type, int]] = {"p": (mi.Float, 3), "d": (mi.Float, 3), "w": (mi.Float, 1)}
ALWAYS |= {"key": (mi.UInt64, 1), "word": (mi.UInt32, 1), "pending": (mi.UInt32, 1)}
OPTIONAL: dict[str, tuple[type, int]] = {
    **dict.fromkeys(("run",), (mi.UInt32, 1)),
    **dict.fromkeys(("normal", "stokes"), (mi.Float, 3)),
    **dict.fromkeys(("child", "scatters", "aimed_from", "medium"), (mi.UInt32, 1)),
    **dict.fromkeys(("birth", "scatter_factor", "medium_factor", "odds", "chance", "near", "link"), (mi.Float, 1)),
    **dict.fromkeys(("joint",), (mi.UInt32, 1)),
    **dict.fromkeys(("length", "away", "shared", "clouded"), (mi.Float, 1)),
}
REFLECTIONS_SHIFT, SURFACE_MASK = 16, 0xFFFF  # of the word of a pending node: the reflections before it, its surface


class PendingNodes:
    """
    The nodes of the current path, in local memory.

    A node to which the lane comes back knows the one above it, so that they make a list of any length.

    Each number has an array of its own over the depth, so that all have the same index: the code then asks once whether
    all lanes are at the same depth, and if they are, a number is one load or store for all of them.

    Parameters
    ----------
    max_events : int
        Most nodes of a path.
    needed : collection of str
        Those of `OPTIONAL` that the scene needs.
    """

    def __init__(self, max_events: int, needed: Collection[str]) -> None:
        numbers = ALWAYS | {name: kind for name, kind in OPTIONAL.items() if name in needed}
        self._numbers = numbers
        self.memory = tuple(
            dr.alloc_local(dtype, max_events) for dtype, count in numbers.values() for _ in range(count)
        )

    def keep(
        self,
        memory: tuple[Any, ...],
        node: dict[str, Any],
        depth: mi.UInt32,
        pending: mi.Bool,
        recorded: mi.Bool,
        recorded_floats: int,
    ) -> tuple[Any, ...]:
        """
        Store nodes.

        Parameters
        ----------
        memory : tuple of dr.Local
            As the loop hands it on.
        node : dict
            Its numbers by their names in the state.
        depth : mi.UInt32
            Where.
        pending : mi.Bool
            Lanes that come back to the node.
        recorded : mi.Bool
            Lanes whose first `recorded_floats` numbers somebody may ask for.
        """
        values = [
            node[name] if count == 1 else node[name][j]
            for name, (_, count) in self._numbers.items()
            for j in range(count)
        ]

        def store(*memory: Any) -> tuple[Any, ...]:
            for j, (array, value) in enumerate(zip(memory, values, strict=True)):
                array.write(value, depth, recorded if j < recorded_floats else pending)
            return memory

        needed = recorded if recorded_floats else pending
        return dr.if_stmt(memory, needed, store, lambda *memory: memory, mode="symbolic", label="keep")

    def resume(self, state: dict[str, Any], child: int) -> dict[str, Any]:
        """Let the lanes that wait at level 1 go on at their nodes with that child, unless the node knows another."""
        waits = state["wait"] == 1
        values = iter([array.read(state["depth"], waits) for array in state["memory"][0]])
        unknown, width = mi.UInt32(0), dr.width(waits)
        node: dict[str, Any] = {"medium": unknown, "child": dr.full(mi.UInt32, child, width), "wait": unknown}
        for name, (_, count) in self._numbers.items():
            node[name] = next(values) if count == 1 else mi.Vector3f(*(next(values) for _ in range(count)))
        word = node.pop("word")
        node["s"] = word & SURFACE_MASK
        node["reflections"] = (word >> REFLECTIONS_SHIFT) & NO_LIMIT
        return {**state, **{name: dr.select(waits, value, state[name]) for name, value in node.items()}}


def node_word(surface: mi.UInt32, reflections: mi.UInt32) -> mi.UInt32:
    """What a pending node keeps of itself in one word."""
    return surface | (reflections << REFLECTIONS_SHIFT)


def wait_level(node: mi.UInt32, trunk: mi.UInt32, back: mi.Bool, levels: int) -> mi.UInt32:
    """Level at which lanes wait that are back at a node; `trunk` is their deepest one before a reflection."""
    level = dr.select(node <= trunk, mi.UInt32(2), 1) if levels > 1 else mi.UInt32(1)
    return dr.select(back, level, 0)


def at_once(
    state: dict[str, Any],
    visit: Callable[[dict[str, Any]], dict[str, Any]],
    resume: Callable[[dict[str, Any]], dict[str, Any]],
) -> dict[str, Any]:
    """Visit nodes until no lane has anything left, without waiting; parameters as for `in_step`."""
    (state,) = dr.while_loop(
        (state,),
        lambda state: state["active"],
        lambda state: (visit(resume(state)),),
        mode="symbolic",
        label="ray tree",
    )
    return state


def in_step(
    state: dict[str, Any],
    visit: Callable[[dict[str, Any]], dict[str, Any]],
    resume: Callable[[dict[str, Any]], dict[str, Any]],
    level: int = LEVELS,
) -> dict[str, Any]:
    """
    Visit nodes until every lane waits at a higher level or has nothing left.

    Parameters
    ----------
    state : dict
        Of the loop; "active" and "wait" say which lanes go on.
    visit : callable
        One visit of the lanes that are under way.
    resume : callable
        Lets the lanes go on that wait at level 1.
    level : int
    """

    def step(state: dict[str, Any]) -> dict[str, Any]:
        if level == 0:
            return visit(state)
        state = resume(state) if level == 1 else {**state, "wait": dr.select(state["wait"] > 1, 1, state["wait"])}
        return in_step(state, visit, resume, level - 1)

    # To find what a loop leaves as it is, Dr.Jit follows its body twice, which would double with each level
    with dr.scoped_set_flag(dr.JitFlag.OptimizeLoops, level == 0):
        (state,) = dr.while_loop(
            (state,),
            lambda state: state["active"] & (state["wait"] <= level),
            lambda state: (step(state),),
            mode="symbolic",
            label=f"ray tree, level {level}",
        )
    return state
