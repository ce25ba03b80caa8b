"""Path tables of backward traces, see `mistray.recorders.sky.PathBook.read`, put together."""

from __future__ import annotations

import numpy as np

from mistray.recorders.ledger import host_keys


def join_books(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Two path tables, see `PathBook.read`, as one."""
    longest = max(first["events"].shape[1], second["events"].shape[1])
    events = np.concatenate(
        [np.pad(book["events"], ((0, 0), (0, longest - book["events"].shape[1]))) for book in (first, second)]
    )
    lengths = np.concatenate([first["lengths"], second["lengths"]])
    _, chosen, place = np.unique(host_keys(events, lengths), return_index=True, return_inverse=True)
    path = place[np.concatenate([first["path"], second["path"] + len(first["lengths"])])]
    cell = np.concatenate([first["cell"], second["cell"]])
    pairs, place = np.unique(np.stack([path, cell], axis=1), axis=0, return_inverse=True)
    sums = {
        name: np.bincount(place.ravel(), np.concatenate([first[name], second[name]]), len(pairs))
        for name in ("hits", "weight", "squares")
    }
    return {"events": events[chosen], "lengths": lengths[chosen], "path": pairs[:, 0], "cell": pairs[:, 1], **sums}
