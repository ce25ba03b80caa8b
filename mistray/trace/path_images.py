"""Images of groups of paths on the detector, by tracing the same rays again."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from mistray.errors import MistrayError
from mistray.execute.by_parts import images_by_parts
from mistray.execute.scene_task import SceneTask
from mistray.execute.tracer import Run
from mistray.execute.workers import current_workers
from mistray.ranges import FLAG, Several, several
from mistray.recorders.film import Pixels, image_word
from mistray.trace.paths import PathTable

PathGroups = int | Sequence[int | Sequence[int]]


def path_images(
    table: PathTable,
    task: SceneTask | None,
    groups: PathGroups,
    with_noise: bool | Sequence[bool],
) -> Iterator[Pixels]:
    """
    Yield the irradiance map of each group of paths, (height, width), W/mm².

    `with_noise` says for each group whether its noise is computed, else it is NaN. Workers trace if there are any and
    `task` is given. An unknown path, or one in two groups, raises `MistrayError`; see `mistray.trace.Trace.each_map`.
    """
    chosen, noisy = several(groups), list(Several(FLAG).check("with_noise", with_noise))
    if not chosen:
        return
    if len(noisy) not in (1, len(chosen)):
        raise MistrayError(f"with_noise has {len(noisy)} values for {len(chosen)} groups; give one, or one for each")
    noisy *= len(chosen) if len(noisy) == 1 else 1
    counts = [len(table.runs[0].film) if noise else 1 for noise in noisy]  # images of each map
    first = np.concatenate([[0], np.cumsum(counts)]).tolist()
    images: dict[int, int] = {}  # path → images of its map
    for number, group in enumerate(chosen):
        word = image_word(first[number], noisy[number])
        for path_id in table.check_ids(group).tolist():
            if images.setdefault(path_id, word) != word:
                raise MistrayError(f"path_id {path_id} is in two groups; a path belongs to one map")
    of_runs = table.located(images)
    words = [np.array([images[path_id] for path_id in own.ids.tolist()], dtype=np.uint32) for own in of_runs]
    workers = current_workers()
    if workers is not None and task is not None:
        paths = [(own.keys, its) for own, its in zip(of_runs, words, strict=True)]
        stacks = images_by_parts(workers, task, table.runs, paths, first[-1])
    else:
        stacks = [own.run.images(own.slots, its, first[-1]) for own, its in zip(of_runs, words, strict=True)]
    for low, high in itertools.pairwise(first):
        yield irradiance_of_runs(table.runs, [stack[low:high] for stack in stacks])


def irradiance_of_runs(runs: Sequence[Run], films: Sequence[np.ndarray]) -> Pixels:
    """
    Return the irradiance that several runs together give on one detector, with its noise, (height, width), W/mm².

    Parameters
    ----------
    runs : sequence of Run
        Runs of the trace.
    films : sequence of (images, height, width) float64
        Images of each run, in units of the flux of its start rays.
    """
    pixel = runs[0].pixel_area
    first, *others = (
        Pixels.of_film(film, run.started, run.unit / pixel) for run, film in zip(runs, films, strict=True)
    )
    return sum(others, start=first)
