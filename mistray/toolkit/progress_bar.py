"""Progress bar of Python sessions: a line of a terminal, or a bar of a notebook."""

from __future__ import annotations

import sys
import warnings
from numbers import Real
from typing import Any, Self

from mistray.errors import MistrayError


class ProgressBar:
    """
    Bar in a terminal or a notebook that functions with an argument `progress` move: ``progress=ProgressBar()``.

    It ends when the work is done, or with its block where it is a context: ``with ProgressBar() as bar:``. In a
    notebook it is a widget if ipywidgets is installed, else a line of text. Elsewhere, as in a log, it shows nothing.

    Parameters
    ----------
    what : str
        Description of the work.

    Raises
    ------
    MistrayError
        If `what` is not a string.

    Examples
    --------
    >>> scene = mistray.load("cooke_triplet")
    >>> report = mistray.ghosts(scene, [0, 10], rays=20_000, progress=mistray.ProgressBar("two fields"))
    >>> [f"{angle:g}°" for angle in report]
    ['0°', '10°']
    """

    def __init__(self, what: str = "tracing") -> None:
        if not isinstance(what, str):
            raise MistrayError(f"what is of type {type(what).__name__}; give a text, such as ProgressBar('PST')")
        self._what, self._total = what, 0.0
        self._bar: Any = None

    def __call__(self, *state: Any) -> None:
        """
        Move the bar to a state of progress, in any form that functions of mistray report.

        The bar never moves back within a plan, and is closed at the end. Without a terminal or notebook, nothing is
        shown.
        """
        done, total = _share(state)
        if self._bar is None:
            self._bar = _bar(self._what)
        if self._bar is None:
            return
        if total != self._total:  # the plan is another one, or a new piece of work begins
            self._bar.n, self._total = 0.0, total
        self._bar.n = max(min(done / total, 1.0) if total > 0 else 0.0, self._bar.n)
        self._bar.refresh()
        if self._bar.n >= 1:
            self.close()

    def close(self) -> None:
        """End the bar; a later call begins a new one."""
        if self._bar is not None:
            self._bar.close()
        self._bar = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _share(state: tuple[Any, ...]) -> tuple[float, float]:
    """
    Return the amount done and the total, in one unit, from what a function passes to `progress`.

    Two numbers at its end are these already: rays or steps. An item with `share_done`, as of a PST or of an
    optimisation, or a single number at the end is the fraction done of 1. Any other state gives 0 and 1.
    """
    for item in state:
        if hasattr(item, "share_done"):
            return float(item.share_done), 1.0
    numbers = [float(item) for item in state[-2:] if isinstance(item, Real)]
    if not numbers or not isinstance(state[-1], Real):
        return 0.0, 1.0
    return (numbers[0], numbers[1]) if len(numbers) == 2 else (numbers[0], 1.0)


def _bar(what: str) -> Any | None:
    """Return a new tqdm bar; None if the session has neither a terminal nor a notebook."""
    kernel = sys.modules.get("ipykernel.kernelapp")
    notebook = kernel is not None and kernel.IPKernelApp.initialized()
    if not notebook and (sys.stderr is None or not sys.stderr.isatty()):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that ipywidgets is not installed
        from tqdm.auto import tqdm

        form = "{desc}: {percentage:3.0f}% |{bar}| {elapsed} < {remaining}"
        return tqdm(desc=what, total=1.0, bar_format=form, leave=notebook, file=sys.stderr, dynamic_ncols=not notebook)
