"""Images of groups of paths on the detector, by tracing the same rays again."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mistray.errors import MistrayError
from mistray.execute.by_parts import images_by_parts
from mistray.execute.tracer import irradiance_of_runs
from mistray.execute.workers import current_workers
from mistray.recorders.film import Pixels, image_word

if TYPE_CHECKING:
    from mistray.trace.result import Trace


def path_images(t: Trace, groups: Sequence[Sequence[int]], with_noise: Sequence[bool]) -> Iterator[Pixels]:
    """Yield the irradiance map of each group of paths, (height, width), W/mm², see `mistray.trace.Trace.each_map`."""
    counts = [len(t.runs[0].film) if noise else 1 for noise in with_noise]  # images of each map
    first = np.concatenate([[0], np.cumsum(counts)]).tolist()
    images: dict[int, int] = {}  # path → images of its map
    for number, group in enumerate(groups):
        word = image_word(first[number], with_noise[number])
        for path_id in group:
            if images.setdefault(int(path_id), word) != word:
                raise MistrayError(f"path_id {path_id} is in two groups; a path belongs to one map")
    words = [
        {slot: images[path_id] for slot, path_id in zip(paths.slots.tolist(), paths.ids.tolist(), strict=True)}
        for paths in t.paths.located(images)
    ]
    workers = current_workers()
    if workers is not None and t.task is not None:
        stacks = images_by_parts(workers, t.task, t.runs, words, first[-1])
    else:
        size = (first[-1], *t.irradiance.shape)  # images, rows, columns
        stacks = [
            run.images(slots, first[-1]) if slots else np.zeros(size)  # a run without such paths is not traced
            for run, slots in zip(t.runs, words, strict=True)
        ]
    for low, high in itertools.pairwise(first):
        yield irradiance_of_runs(t.runs, [stack[low:high] for stack in stacks])
