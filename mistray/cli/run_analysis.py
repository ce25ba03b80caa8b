"""Run of the command of an analysis: make the request, load the scene, trace, write the files, print."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
from typing import Any

from mistray.cli.parsed_options import Options
from mistray.toolkit.command import AnalysisCommand
from mistray.toolkit.field_options import request_of


def run_analysis(command: AnalysisCommand, options: Options) -> int:
    """Run the command of an analysis with its options; return the exit code 0."""
    names = filter(None, (command.request, command.shown))
    request, *shown = (request_of(getattr(command.requests, name), vars(options)) for name in names)
    options.start()
    run = importlib.import_module(f"{command.package}.run").run
    page = _page_of(command)
    scene = options.load()
    with options.tracing() as progress:
        limit = {"seconds": options.seconds_left()} if "seconds" in inspect.signature(run).parameters else {}
        found = run(scene, request, progress=progress, **limit)
    files = options.write(lambda title, line: page.page(found, *shown, title, line))
    return options.show(lambda: page.record(found, *shown), lambda: page.text(found, *shown), files, result=found)


def _page_of(command: AnalysisCommand) -> Any:
    """Return the module ``page`` of an analysis, which formats its results, else a `PlainPage` of their tables."""
    name = f"{command.package}.page"
    if importlib.util.find_spec(name) is not None:
        return importlib.import_module(name)
    from mistray.toolkit.plain_page import PlainPage

    return PlainPage(command.name, f"{command.help[:1].upper()}{command.help[1:]}")
