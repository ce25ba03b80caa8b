"""Tasks on a scene: an object that each worker builds again, and whose parts it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.execute.fingerprint import agree


@dataclass(frozen=True, eq=False)
class SceneTask:
    """
    Task on a scene: each worker builds an object of class `kind`, which then does parts, see `mistray.execute.workers`.

    Attributes
    ----------
    kind : callable
        Class of the object. It has ``kernel_arrays()``, the arrays that the kernel reads for each wavelength, and
        ``do(part)``, the sums of a part.
    scene : mi.Scene
    arguments : tuple
        Other arguments of the class.
    arrays : sequence of list of array
        Arrays that the kernel reads here: workers check that they have the same.
    """

    kind: Callable[..., Any]
    scene: mi.Scene
    arguments: tuple[Any, ...]
    arrays: Sequence[list[np.ndarray]]

    def make(self) -> Any:
        """Return the object that a worker builds; raise an error if its kernel would read other arrays than here."""
        made = self.kind(self.scene, *self.arguments)
        there = made.kernel_arrays()
        if len(self.arrays) != len(there) or not all(agree(a, b) for a, b in zip(self.arrays, there, strict=True)):
            raise MistrayError(
                "the scene is another one at the worker than here: it, or a file that it names, has changed since it "
                "was loaded or traced; load it again"
            )
        return made

    def do(self, made: Any, part: Any) -> Any:
        """Return the sums of one part, as the worker's object computes them."""
        return made.do(part)
