"""Pending nodes of the ray tree, to which lanes return for further children, and the lockstep of lanes in a packet.

A lane that has followed a branch to its end goes on at its deepest pending node. If each did so at once, the first of
them whose branch is one surface shorter would be one node ahead of the others from then on: neighbours would be at
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

from mistray.kernel.kernel_scene import KernelScene
from mistray.settings import NO_LIMIT, Settings

LEVELS = 2
FLOAT, WORD, LONG, VECTOR = (mi.Float, 1), (mi.UInt32, 1), (mi.UInt64, 1), (mi.Float, 3)
# Variables of a node, by their names in the loop's state: type and count. Recorders may read the first floats
ALWAYS: dict[str, tuple[type, int]] = {
    "p": VECTOR,
    "d": VECTOR,
    "w": FLOAT,
    "key": LONG,
    "word": WORD,
    "pending": WORD,
}
OPTIONAL: dict[str, tuple[type, int]] = {
    "run": WORD,
    "seed": WORD,
    "normal": VECTOR,
    "stokes": VECTOR,
    "child": WORD,
    "scatters": WORD,
    "aimed_from": WORD,
    "medium": WORD,
    "reference": FLOAT,
    "split": WORD,
    "survival": FLOAT,
    "pdf_ratio": FLOAT,
    "survival_ratio": FLOAT,
    "partial_ratio": FLOAT,
    "connection_ratio": FLOAT,
    "light_vertex": WORD,
    "length": FLOAT,
    "away": FLOAT,
    "shared": FLOAT,
    "in_scattered": FLOAT,
}
REFLECTIONS_SHIFT, SURFACE_MASK = 16, 0xFFFF  # bit fields of the word of a node: reflections before it, its surface


class PendingNodes:
    """
    Nodes of each lane's current path in the ray tree, stored by depth in local memory.

    Each pending node holds the depth of the one above it, so that they make a list of any length.

    Each variable has an array of its own over the depth, so that all have the same index: the code then asks once
    whether all lanes are at the same depth, and if they are, a variable is one load or store for all of them.

    Parameters
    ----------
    max_events : int
        Largest number of nodes of a path.
    needed : collection of str
        Names of the variables in `OPTIONAL` that the scene needs.
    """

    def __init__(self, max_events: int, needed: Collection[str]) -> None:
        self._variables = ALWAYS | {name: kind for name, kind in OPTIONAL.items() if name in needed}
        self.memory = tuple(
            dr.alloc_local(dtype, max_events) for dtype, count in self._variables.values() for _ in range(count)
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
        Store the current node of each lane in `pending` or `recorded` at its depth, and return the arrays.

        Parameters
        ----------
        memory : tuple of dr.Local
            Arrays of the loop.
        node : dict
            Variables of the node by their names in the state.
        depth : mi.UInt32
            Index into the arrays.
        pending : mi.Bool
            Lanes that come back to the node.
        recorded : mi.Bool
            Lanes whose first `recorded_floats` variables a recorder may read.
        """
        node = {**node, "word": node["s"] | (node["reflections"] << REFLECTIONS_SHIFT)}
        values = [
            node[name] if count == 1 else node[name][j]
            for name, (_, count) in self._variables.items()
            for j in range(count)
        ]

        def store(*memory: Any) -> tuple[Any, ...]:
            for j, (array, value) in enumerate(zip(memory, values, strict=True)):
                array.write(value, depth, recorded if j < recorded_floats else pending)
            return memory

        needed = recorded if recorded_floats else pending
        return dr.if_stmt(memory, needed, store, lambda *memory: memory, mode="symbolic", label="keep")

    def resume(self, state: dict[str, Any], child: int) -> dict[str, Any]:
        """
        Return the loop state after the lanes that wait at level 1 have resumed their pending nodes.

        They go on at the stored child; at the child with the index `child` if nodes store none, as without scatter.
        """
        resumes = state["resume_level"] == 1
        values = iter([array.read(state["depth"], resumes) for array in state["memory"][0]])
        unknown, width = mi.UInt32(0), dr.width(resumes)
        node: dict[str, Any] = {"medium": unknown, "child": dr.full(mi.UInt32, child, width), "resume_level": unknown}
        for name, (_, count) in self._variables.items():
            node[name] = next(values) if count == 1 else mi.Vector3f(*(next(values) for _ in range(count)))
        word = node.pop("word")
        node["s"] = word & SURFACE_MASK
        node["reflections"] = (word >> REFLECTIONS_SHIFT) & NO_LIMIT
        return {**state, **{name: dr.select(resumes, value, state[name]) for name, value in node.items()}}


def needed_variables(scene: KernelScene, settings: Settings) -> set[str]:
    """Return the names of the node variables in `OPTIONAL` that a trace of the scene needs."""
    table, scatters, competing = scene.table, scene.scatters(settings), scene.competing
    bulk = table.optics.scatters
    names_by_need: tuple[tuple[bool, set[str]], ...] = (
        (settings.limits_consecutive, {"run"}),
        (scene.draws(settings), {"seed"}),
        (settings.stokes, {"stokes"}),
        (table.mitsuba_scene is not None, {"normal"}),
        (bulk, {"length", "in_scattered"}),
        (competing is not None, {"pdf_ratio", "survival_ratio"}),
        (competing is not None and competing.connects, {"partial_ratio", "connection_ratio", "light_vertex"}),
        (scatters, {"child", "medium", "scatters", "aimed_from", "reference"}),
        (scene.windows is not None, {"split", "survival"}),
        (scatters and bulk, {"away", "shared"}),
    )
    return {name for is_needed, names in names_by_need if is_needed for name in names}


def walk_in_lockstep(
    state: dict[str, Any],
    visit: Callable[[dict[str, Any]], dict[str, Any]],
    resume: Callable[[dict[str, Any]], dict[str, Any]],
    level: int = LEVELS,
) -> dict[str, Any]:
    """
    Visit nodes of the ray tree until every lane waits above `level` or has no pending node left.

    Parameters
    ----------
    state : dict
        Variables of the loop; "active" and "resume_level" say which lanes go on.
    visit : callable
        Makes one visit of the lanes that are under way.
    resume : callable
        Lets the lanes go on that wait at level 1.
    level : int
        Highest wait level whose lanes go on; 0: none, only visits are made.
    """

    def step(state: dict[str, Any]) -> dict[str, Any]:
        if level == 0:
            return visit(state)
        state = (
            resume(state)
            if level == 1
            else {**state, "resume_level": dr.select(state["resume_level"] > 1, 1, state["resume_level"])}
        )
        return walk_in_lockstep(state, visit, resume, level - 1)

    return recorded_once(
        state, lambda state: state["active"] & (state["resume_level"] <= level), step, f"ray tree, level {level}"
    )


def recorded_once(
    state: dict[str, Any],
    condition: Callable[[dict[str, Any]], mi.Bool],
    step: Callable[[dict[str, Any]], dict[str, Any]],
    label: str,
) -> dict[str, Any]:
    """
    Return the final variables of a symbolic loop whose body Dr.Jit records once instead of twice.

    `state` has the variables, and `step` returns them after one pass of the loop, in lanes where `condition` holds.
    To find variables that a loop leaves as they are, Dr.Jit follows its body twice. The loops of the ray tree have
    none, see `_Tree.walk`, and recording them is a quarter of the time of a trace of few rays.
    """
    with dr.scoped_set_flag(dr.JitFlag.OptimizeLoops, False):
        (state,) = dr.while_loop((state,), condition, lambda state: (step(state),), mode="symbolic", label=label)
    return state
