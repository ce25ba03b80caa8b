"""Roofline of the kernel: operations, loads and cycles of its parts, for a ray segment of all lanes of a packet.

    python benchmarks/roofline.py                # the table of docs/kernels.md
    python benchmarks/roofline.py cooke_triplet

One thread. The clock is that of a chain of dependent additions of products. Intersection and interaction run by
themselves on segments of the scene's own tree, ten times each, so that what is read from memory drops out; the rest is
what a trace takes without recorders, less these. The film, sums by surface and the path table are what a trace takes
longer with them.

Operations are those of Dr.Jit's code of a part, of all lanes together. In the first two parts blocks behind a condition
count by the share of packets that run them, and in the others as if all did; code of loops counts once. A load is an
operand that a block finds in memory: a number of a surface, or a variable that was made before. The bound of a part is
the largest of its operations over `PER_CYCLE`, of its divisions and roots by what each keeps the divider busy, and of
its loads and gathers over what a core reads: of a core with AVX-512 (A. Fog, Instruction tables, Ice Lake).
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from unittest.mock import patch

import drjit as dr
import mitsuba as mi
import numpy as np
from rows import alternate

import mistray
from mistray.events import EVENT_BITS
from mistray.execute.tracer import Run, prepare
from mistray.kernel.interaction import interact
from mistray.recorders.film import Images
from mistray.recorders.ledger import Ledger
from mistray.recorders.recorder import Memory, Recorder
from mistray.recorders.start_rays import StartRays
from mistray.recorders.tallies import Tallies
from mistray.settings import Settings
from mistray.surfaces.upload import upload

SCENES = {"double_gauss": 1 << 17, "phone_camera": 1 << 13}
REPEATS, TIMES = 7, 10
PER_CYCLE, LOADS_PER_CYCLE = 2.0, 2.0  # of a packet of 16 floats
DIVISION, ROOT, GATHER = 16.0, 19.0, 11.0  # cycles of a packet
LANES = 16  # of a packet
CHAIN, FMA_LATENCY = 64, 4  # dependent fused operations of a step, cycles of each
BRANCHES = 1 << 14
LINE = re.compile(r"\s+(?:(%\w+) = )?(?:tail )?(\w+) (.*)")
LABEL = re.compile(r"(l_\d+_t):")
MEMORY = {"load", "insertelement", "shufflevector"}  # what makes a number of a surface, or a literal, for all lanes
FREE = MEMORY | {"phi", "br", "bitcast", "getelementptr", "fneg", "ret", "extractelement"}


@dataclass(frozen=True)
class Operations:
    """Operations of a packet: arithmetic, divisions, roots, operands from memory, gathers, and stores."""

    arithmetic: float = 0.0
    divisions: float = 0.0
    roots: float = 0.0
    loads: float = 0.0
    gathers: float = 0.0
    stores: float = 0.0

    def __add__(self, other: Operations) -> Operations:
        return Operations(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    def without(self, other: Operations) -> Operations:
        """What is left without others; operands that parts share may be more than are left."""
        return Operations(*(max(a - b, 0.0) for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    def __rmul__(self, factor: float) -> Operations:
        return Operations(*(factor * value for value in vars(self).values()))

    @property
    def total(self) -> float:
        """Number of those that compute."""
        return self.arithmetic + self.divisions + self.roots

    @property
    def bound(self) -> float:
        """Fewest cycles that they take."""
        divider = DIVISION * self.divisions + ROOT * self.roots
        reading = self.loads / LOADS_PER_CYCLE + GATHER * self.gathers
        return max(self.arithmetic / PER_CYCLE, divider, reading)


def kind_of(operation: str, rest: str) -> str:
    """Field of `Operations` of a line of LLVM's code; "" if it costs nothing."""
    if operation in FREE:
        return ""
    if operation == "fdiv":
        return "divisions"
    if operation == "call":
        names = {"sqrt": "roots", "gather": "gathers", "scatter": "stores", "assume": ""}
        return next((kind for name, kind in names.items() if name in rest), "arithmetic")
    return "stores" if operation in ("store", "atomicrmw", "cmpxchg") else "arithmetic"


def operations(code: str) -> list[Operations]:
    """Operations of each block of a kernel: first all that has no condition, then blocks behind one, in order."""
    found, made, lanes = [Counter[str]()], [set[str]()], int((re.search(r"<(\d+) x", code) or "1")[1])
    inside: list[int] = [0]
    labels: list[str] = []
    for line in code.splitlines():
        if label := LABEL.match(line):
            inside.append(len(found))
            labels.append(label[1])
            found.append(Counter())
            made.append(set())
        elif labels and line == f"{labels[-1]}_trailer:":
            inside.pop()
            labels.pop()
        elif parts := LINE.match(line):
            name, operation, rest = parts.groups()
            here = inside[-1]
            if name and operation not in MEMORY:
                made[here].add(name)
            if kind := kind_of(operation, rest):
                wide = f"<{lanes} x double>" in rest or f"<{lanes} x i64>" in rest
                found[here][kind] += 2 if wide else 1
                operands = set(re.findall(r"%[fdr]\d+\b", rest))
                for operand in operands - made[here]:
                    made[here].add(operand)
                    found[here]["loads"] += 1
    return [Operations(**counter) for counter in found]


def code_of(work: Callable[[], Any]) -> str:
    """LLVM's code of the largest kernel that something launches."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        work()
        kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    text: str = max(kernels, key=lambda kernel: kernel["operation_count"])["ir"].getvalue()
    return text


def run_by(work: Callable[[], Any], packets: int) -> list[float]:
    """Share of packets that run each block behind a condition, in their order in the code."""
    marks, blocks = dr.zeros(mi.UInt32, 4096 * packets), iter(range(4096))
    lanes, if_stmt = dr.arange(mi.UInt32, LANES * packets), dr.if_stmt
    dr.eval(marks, lanes)

    def marked(args: Any, cond: Any, true_fn: Any, false_fn: Any, **more: Any) -> Any:
        number = next(blocks)

        def true(*values: Any) -> Any:
            dr.scatter(marks, mi.UInt32(1), lanes // LANES + number * packets, cond)
            return true_fn(*values)

        return if_stmt(args, cond, true, false_fn, **more)

    with patch.object(dr, "if_stmt", marked):
        work()
    count = next(blocks)
    return np.array(marks).reshape(-1, packets)[:count].mean(axis=1).tolist()


def clock_hz() -> float:
    """Clock of a core at work, by a chain of operations each of which waits for the one before."""
    a, steps = dr.opaque(mi.Float, 0.999), 20_000

    def work(count: mi.UInt32) -> None:
        def step(k: mi.UInt32, x: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            for _ in range(CHAIN):
                x = dr.fma(x, a, a)
            return k + 1, x

        state = (dr.zeros(mi.UInt32, LANES), dr.zeros(mi.Float, LANES))
        dr.eval(dr.while_loop(state, lambda k, _: k < count, step, mode="symbolic"))
        dr.sync_thread()

    short, long = (dr.opaque(mi.UInt32, count) for count in (steps, 5 * steps))
    few, many = alternate(lambda: work(short), lambda: work(long), repeats=REPEATS)
    return 4 * steps * CHAIN * FMA_LATENCY / (many.seconds - few.seconds)


@dataclass(frozen=True)
class Segments:
    """Ray segments of a tree: origins and points where they end, mm, directions, and surfaces at both ends."""

    o: mi.Vector3f
    p: mi.Vector3f
    d: mi.Vector3f
    last: mi.UInt32
    s: mi.UInt32

    @classmethod
    def of(cls, run: Run) -> Segments:
        """Segments of branches that end in the detector, those of neighbours on the same path side by side."""
        recorder = run.record(None, BRANCHES)
        count, events = min(int(recorder.count[0]), recorder.capacity), run.settings.max_events
        lengths, lanes, paths = (np.array(one)[:count] for one in (recorder.length, recorder.lane, recorder.path))
        nodes = np.array(recorder.nodes).reshape(recorder.capacity, events, -1)[:count]
        surfaces = np.array(recorder.codes).reshape(recorder.capacity, events)[:count] >> EVENT_BITS
        order, parts = np.lexsort((lanes, paths)), []
        for depth in range(1, int(lengths.max())):
            here = order[lengths[order] > depth]
            before, after = nodes[here, depth - 1], nodes[here, depth]
            ends = surfaces[here, depth - 1 : depth + 1]
            parts.append(np.column_stack([before[:, :3], after[:, :6], ends]))
        rows = np.concatenate(parts)
        columns = rows[: len(rows) // LANES * LANES].T
        o, p, d = (mi.Vector3f(*(upload(mi.Float, column) for column in columns[k : k + 3])) for k in (0, 3, 6))
        return cls(o, p, d, upload(mi.UInt32, columns[9]), upload(mi.UInt32, columns[10]))

    @property
    def packets(self) -> int:
        """Number of packets."""
        return dr.width(self.s) // LANES


class Segmented(Recorder):
    """Recorder of nothing but the number of ray segments."""

    def __init__(self) -> None:
        self.segments = dr.zeros(mi.Float64, 1)

    def end(self, start: StartRays, segments: mi.UInt32, cut_off: mi.Bool, active: mi.Bool, memory: Memory) -> None:
        dr.scatter_reduce(dr.ReduceOp.Add, self.segments, mi.Float64(segments), mi.UInt32(0), active)


@dataclass(frozen=True)
class Part:
    """Part of the kernel: its operations, those that packets run, and cycles of a packet and segment."""

    name: str
    code: Operations
    done: Operations | None
    cycles: float

    def __str__(self) -> str:
        one = self.done or self.code
        memory = ", ".join(f"{value:.0f}" for value in (one.loads, one.gathers, one.stores))
        cells = [self.name, f"{self.code.total:.0f}", "", f"{one.divisions + one.roots:.0f}", memory, ""]
        cells += [f"{self.cycles:.0f}", ""]
        if self.done is not None:
            bound = self.done.bound
            cells[2], cells[5], cells[7] = f"{self.done.total:.0f}", f"{bound:.0f}", f"{self.cycles / bound:.1f}"
        return f"| {' | '.join(cells)} |"


HEAD = (
    "| part | operations in the code | that run | divisions and roots | loads, gathers, stores | bound, cycles "
    "| cycles | over the bound |\n|---|---|---|---|---|---|---|---|"
)


def alone(name: str, segments: Segments, hz: float, work: Callable[[mi.Vector3f, mi.Vector3f], mi.Float]) -> Part:
    """A part by itself: its operations, and its cycles by ten times over once."""

    def once() -> None:
        dr.eval(work(segments.o, segments.p))

    def several(count: mi.UInt32) -> None:
        def step(k: mi.UInt32, total: mi.Float) -> tuple[mi.UInt32, mi.Float]:
            # Each time a bit farther, or the compiler would do it once
            ahead = 1e-7 * mi.Float(k)
            return k + 1, total + work(dr.fma(ahead, segments.d, segments.o), dr.fma(ahead, segments.d, segments.p))

        state = (dr.zeros(mi.UInt32, dr.width(segments.s)), dr.zeros(mi.Float, dr.width(segments.s)))
        dr.eval(dr.while_loop(state, lambda k, _: k < count, step, mode="symbolic"))
        dr.sync_thread()

    code, shares = operations(code_of(once)), [1.0, *run_by(once, segments.packets)]
    done = sum((share * block for block, share in zip(code, shares, strict=True)), start=Operations())
    short, long = (dr.opaque(mi.UInt32, count) for count in (1, 1 + TIMES))
    few, many = alternate(lambda: several(short), lambda: several(long), repeats=REPEATS)
    cycles = hz * (many.seconds - few.seconds) / (TIMES * segments.packets)
    return Part(name, sum(code, start=Operations()), done, cycles)


def parts_of(name: str, rays: int, hz: float) -> Iterator[Part]:
    """Parts of the kernel of a shipped scene."""
    (run,) = prepare(mistray.load(name), Settings(rays=rays))
    segments, table = Segments.of(run), run.table

    def meet(o: mi.Vector3f, p: mi.Vector3f) -> mi.Float:
        t, s = run.intersector.nearest(o, segments.d, segments.last, mi.Bool(True))
        return t + mi.Float(s)

    def change(o: mi.Vector3f, p: mi.Vector3f) -> mi.Float:
        it = interact(table, p, segments.d, segments.s, None, None, mi.Bool(True))
        return dr.sum(it.p) + dr.sum(it.reflected) + dr.sum(it.transmitted) + it.R + it.T

    hit, interaction = alone("intersection", segments, hz, meet), alone("interaction", segments, hz, change)

    # The whole kernel with more and more recorders; what each adds to the code runs once a segment at most
    counted, tallies = Segmented(), Tallies(table)
    image, ledger = Images(run.make_film()), Ledger(1 << 12, run.settings.max_events)
    start = run.start_pass(0)
    sets: Sequence[Sequence[Recorder]] = ([counted], [tallies], [tallies, image], [tallies, ledger, image])
    works = [partial(run.trace_trees, start, *given) for given in sets]
    codes = [sum(operations(code_of(work)), start=Operations()) for work in works]
    counted.segments = dr.zeros(mi.Float64, 1)
    times = alternate(*works, repeats=REPEATS)
    walked = float(counted.segments[0]) / (REPEATS + 1)
    cycles = [hz * timing.seconds * LANES / walked for timing in times]
    yield hit
    yield interaction
    own = codes[0].without(hit.code + interaction.code)
    yield Part("choice of the child, nodes, loop", own, own, cycles[0] - hit.cycles - interaction.cycles)
    for k, what in enumerate(("sums by surface", "film", "path table")):
        own = codes[k + 1].without(codes[k])
        yield Part(what, own, own, cycles[k + 1] - cycles[k])
    yield Part("all", codes[-1], None, cycles[-1])


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table of each scene."""
    parser = argparse.ArgumentParser(description="Roofline of the kernel.")
    parser.add_argument("scenes", nargs="*", default=list(SCENES), help=f"shipped scenes ({', '.join(SCENES)})")
    threads = dr.thread_count()
    mistray.set_threads(1)
    try:
        hz = clock_hz()
        print(f"clock: {hz / 1e9:.2f} GHz")
        for name in parser.parse_args(argv).scenes:
            print(f"\n`{name}`, packet of {LANES} lanes, a segment\n\n{HEAD}")
            for part in parts_of(name, SCENES.get(name, 1 << 15), hz):
                print(part, flush=True)
    finally:
        mistray.set_threads(threads)


if __name__ == "__main__":
    main()
