"""`mistray optimize`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.arguments import RAW, count
from mistray.errors import MistrayError

if TYPE_CHECKING:
    from mistray.optimize import Design, Step

INTERRUPTED = 130


def add(commands: Any) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "optimize",
        help="make stray light small by the thicknesses of coatings",
        description="Search thicknesses of coatings that make a metric of a scene small, along the gradient of the\n"
        "traced metric, and prove the result on other random numbers. STUDY is a TOML file that says what is to be\n"
        "made small and by which coatings; docs/optimization.md describes it.",
        epilog="examples:\n"
        "  mistray optimize cooke_triplet examples/triplet_ar.toml --out out/triplet_ar\n"
        "  mistray optimize cooke_triplet examples/triplet_ar.toml --out out/triplet_ar --steps 80 --resume",
        formatter_class=RAW,
    )
    parser.add_argument("scene", metavar="SCENE", help="scene XML file, or the name of a shipped scene")
    parser.add_argument("study", metavar="STUDY", type=Path, help="TOML file")
    parser.add_argument(
        "--steps", type=count, metavar="N", help="most steps of each search (default: as the study says)"
    )
    parser.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    parser.add_argument("--out", type=Path, metavar="DIR",
                        help="write scene.xml, report.html, tables, pictures and the checkpoint there")  # fmt: skip
    parser.add_argument("--variant", metavar="NAME", help="Mitsuba variant, such as cuda_ad_rgb (llvm_ad_rgb)")
    parser.add_argument("--quiet", action="store_true", help="no progress, no report")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    from mistray._mitsuba_compat import silence_warnings
    from mistray._variant import ensure_variant

    if options.resume and options.out is None:
        raise MistrayError("--resume needs the folder of the checkpoint; give --out")
    ensure_variant(options.variant)  # settles libLLVM before anything imports Mitsuba
    silence_warnings()
    from mistray.optimize import optimize_coatings
    from mistray.report import writable_directory
    from mistray.report.optimization import report_text, write_optimization

    checkpoint = None
    shown = not options.quiet and sys.stderr.isatty()
    saved = options.resume
    if options.out is not None:
        checkpoint = writable_directory(options.out) / "checkpoint.json"

    def progress(step: Step, design: Design) -> None:
        nonlocal saved
        saved = checkpoint is not None
        if shown:
            _show(step, design)

    try:
        result = optimize_coatings(
            options.scene,
            options.study,
            steps=options.steps,
            checkpoint=checkpoint,
            resume=options.resume,
            progress=progress,
        )
        files = [] if options.out is None else write_optimization(result, options.out, options.command_line)
    except KeyboardInterrupt:
        if not saved:
            raise
        print(f"mistray: interrupted; all steps are in {checkpoint}, go on with --resume", file=sys.stderr)
        return INTERRUPTED
    if not options.quiet:
        print(report_text(result))
        if files:
            print(f"\n{len(files)} files in {options.out}; open {options.out / 'report.html'}")
    return 0


def _show(step: Step, design: Design) -> None:
    """One line for each step on stderr."""
    print(
        f"start {step.start + 1} ({design.name}), step {step.step}: {step.value:.4e} ± {step.value_se:.1e}, "
        f"|gradient| {step.gradient_norm:.1e}/nm, {step.seconds:.0f} s",
        file=sys.stderr,
        flush=True,
    )
