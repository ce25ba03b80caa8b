"""Runs a part of the attack."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

from attack import in_process, processes
from attack.worker import Worker

IN_PROCESS = {
    "options": in_process.options, "xml": in_process.xml, "numbers": in_process.numbers, "files": in_process.files,
    "bombs": in_process.bombs, "entries": in_process.entries,
}  # fmt: skip
PROCESSES = {
    "kills": processes.kills, "renames": processes.renames, "interrupts": processes.interrupts,
    "first_second": processes.first_second, "surroundings": processes.surroundings, "requests": processes.requests,
    "limits": processes.limits,
}  # fmt: skip


@dataclass
class Done:
    """How many cases were tried, in how many seconds, and what failed, by the name of the case."""

    tried: int = 0
    seconds: float = 0.0
    failures: dict[str, str] = field(default_factory=dict)


def run_part(part: str, folder: Path, seed: int = 1, every: int = 1, print_failures: bool = False) -> Done:
    """Run one of `every` cases of a part, in a folder that is its own."""
    done, began = Done(), time.monotonic()
    in_process.prepare(folder)
    worker = Worker(folder, MISTRAY_CACHE=str(folder / "cache"))
    try:
        cases = IN_PROCESS[part](worker, seed) if part in IN_PROCESS else PROCESSES[part](folder, seed)
        for case in cases[::every]:
            wrong = case.run()
            done.tried += 1
            if wrong:
                done.failures[case.name] = wrong
                if print_failures:
                    print(f"{part}: {case.name}: {wrong}", flush=True)
    finally:
        worker.close()
    done.seconds = time.monotonic() - began
    return done
