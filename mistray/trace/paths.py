"""The path table: one row for each path from a source to the detector."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.execute.tracer import Run
from mistray.ranges import several, shown
from mistray.recorders.path_events import DIRECT, describe_events, event_keys, way, way_letters, way_text
from mistray.recorders.path_key import host_keys
from mistray.recorders.sampled import Sampled, sum_of_runs
from mistray.result import KeyNumber, Result
from mistray.settings import BATCHES
from mistray.trace.filter_rows import Rows
from mistray.trace.located_paths import LocatedPaths
from mistray.trace.named_paths import warn_unless_one
from mistray.trace.path_aliases import KEPT_APART, NAMES, alias_names, aliased
from mistray.trace.path_filter import PathFilter
from mistray.trace.path_numbers import ABSORBED, CHUNK, RAYS, HitSums, PathNumbers, alike, path_numbers, percents
from mistray.trace.path_row import PathRow

if TYPE_CHECKING:
    import pandas as pd

ROWS_PRINTED = 20
# Columns that paths have in common whose rays have similar weights
SAME_KIND = ("source", "detector", "kind", "scatters", "scatter_1")
MOMENT_SUMS = [2, 3, 4, 5]  # sums of the ledger: absorbed, absorbed · x, absorbed · y, absorbed · (x² + y²)


class PathTable(
    Sequence[PathRow],
    Result,
    table="..toolkit.tables.traces:paths_table",
    figure="..toolkit.figures.traces:paths_figure",
):
    """
    Table of the paths from the sources to the detectors, the strongest first.

    It is a sequence of `PathRow`; `to_pandas`, `to_csv` and `to_parquet` return or write the whole table.

    Parameters
    ----------
    columns : mapping of str to (p,) array
        Attributes of `PathRow`; ``path_id`` starts at 0.
    runs : sequence of Run
        Runs with a ledger.
    run, place : (p,) int
        Index of the run of each path, and its place in the ledger of that run.
    numbers : PathNumbers
        Power, centroid, radius and polarisation of the paths.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> t.paths[1].label
    'L2_front → L1_rear'
    >>> len(t.paths.find("L2_front", "L1_rear"))
    8
    """

    def __init__(
        self,
        columns: Mapping[str, np.ndarray],
        runs: Sequence[Run],
        run: np.ndarray,
        place: np.ndarray,
        numbers: PathNumbers,
    ) -> None:
        self._numbers = numbers
        self._columns = {f.name: np.asarray(columns[f.name]) for f in fields(PathRow)}
        self.runs, self._run, self._place = list(runs), run, place

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of paths, the stray power (W) and the name of the strongest path, if any, by label."""
        found: dict[str, KeyNumber] = {"paths": len(self), "stray [W]": self.stray_W}
        return found | ({"strongest": self[0].label} if len(self) else {})

    @overload
    def __getitem__(self, index: int) -> PathRow: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[PathRow]: ...
    def __getitem__(self, index: int | slice) -> PathRow | Sequence[PathRow]:
        if isinstance(index, slice):
            return list(self._rows(index))
        if not -len(self) <= index < len(self):
            raise IndexError(f"row {index} of a table of {len(self)} paths")
        (row,) = self._rows(slice(index, index + 1 or None))
        return row

    def __len__(self) -> int:
        return len(self._columns["path_id"])

    def __iter__(self) -> Iterator[PathRow]:
        return self._rows(slice(None))

    def _rows(self, chosen: slice | np.ndarray) -> Iterator[PathRow]:
        columns = [column[chosen].tolist() for column in self._columns.values()]
        # One and the same NaN everywhere, so that a row is equal to itself when it is requested again
        columns = [[math.nan if value != value else value for value in column] for column in columns]
        return (PathRow(*values) for values in zip(*columns, strict=True))

    def located(self, path_ids: int | Iterable[int] | None = None) -> list[LocatedPaths]:
        """Return, for each run, its paths among the given ids (None: all); raise `MistrayError` for an unknown id."""
        ids = np.arange(len(self)) if path_ids is None else self.check_ids(path_ids)
        owns = (ids[self._run[ids] == number] for number in range(len(self.runs)))
        return [LocatedPaths(run, own, self._place[own]) for run, own in zip(self.runs, owns, strict=True)]

    def check_ids(self, path_ids: int | Iterable[int]) -> np.ndarray:
        """Return one or several path ids as an array, (n,) int64; raise `MistrayError` for an unknown one."""
        ids = np.zeros((1, 1))
        with contextlib.suppress(ValueError):  # lists of several lengths
            ids = np.atleast_1d(path_ids if isinstance(path_ids, np.ndarray) else several(path_ids))
        plain = ids.ndim == 1 and (ids.dtype.kind in "iuf" or not ids.size)
        wrong = ids[~((ids >= 0) & (ids < len(self)) & (ids == np.floor(ids)))].tolist() if plain else [path_ids]
        if wrong:
            known = f"the paths 0 … {len(self) - 1}" if len(self) else "no paths"
            raise MistrayError(f"path_id {shown(wrong[0])} does not exist; this trace has {known}")
        return ids.astype(np.int64)

    def find(self, *surfaces: str) -> list[PathRow]:
        """
        Return the paths that meet surfaces in a given order, the strongest first.

        Parameters
        ----------
        *surfaces : str
            Ids of surfaces, media or parts, each with an optional letter of the event there, as in ``:T``; they must
            occur in this order, other events may lie between. ``:r`` and ``:t`` mean aimed scatter, too, ``:j`` and
            ``:i`` mean it alone. ``*`` stands for any letters, ``?`` for one.
            ``find("detector:R", "window_rear:R")`` are the detector-window ghosts.

        Raises
        ------
        MistrayError
            For a name or a letter that does not exist.
        """
        return self._that_pass(PathFilter.in_order(surfaces))

    def select(self, selection: str) -> list[PathRow]:
        """
        Return the paths that a filter selects, the strongest first.

        Parameters
        ----------
        selection : str
            Filter such as ``"S(barrel*) & !G & power_W > 1e-9"``, see `mistray.trace.path_filter`; columns are the
            attributes of `PathRow`. Or a kind, as "ghost" or "stray", all events of a path, or its `label`, with -> for
            the arrow.

        Raises
        ------
        MistrayError
            For a filter that cannot be parsed or names something that does not exist.
        """
        return self._that_pass(PathFilter(selection))

    def _that_pass(self, requested: PathFilter) -> list[PathRow]:
        return list(self._rows(np.sort(np.concatenate([own.ids for own in self.chosen(requested)]))))

    def chosen(self, requested: PathFilter, by_ray: frozenset[str] = frozenset()) -> list[LocatedPaths]:
        """
        Return, for each run, the paths that a filter may select; warn if it is a name of none or several of them.

        Parameters
        ----------
        requested : PathFilter
            Filter.
        by_ray : frozenset of str
            Names of columns that a ray has and a path does not.

        Raises
        ------
        MistrayError
            If the filter names what does not exist.
        """
        of_runs = self.located()
        sources = list(dict.fromkeys(run.source.name for run in self.runs))
        rows = []
        for own in of_runs:
            columns = {name: column[own.ids] for name, column in self._columns.items() if name not in by_ray}
            table = own.run.table
            rows.append(Rows(own.events, table.event_parts, columns, table.count, by_ray, sources))
        held = [requested.bounds(own).possible for own in rows]
        if requested.name:  # a name may mean several paths, or none
            warn_unless_one(requested.name, rows, held)
        return self.located(np.concatenate([own.ids[here] for own, here in zip(of_runs, held, strict=True)]))

    def column(self, name: str) -> np.ndarray:
        """
        Return one column of the table, an attribute of `PathRow` for all paths, (p,).

        Any other name raises `KeyError`.
        """
        return self._columns[name]

    def power(self, path_ids: int | Sequence[int] | np.ndarray) -> tuple[float, float]:
        """
        Return the total power of some paths and its standard error, W; a path that is given twice counts once.

        The error of the sum over the paths of a run comes from the spread of its batches of start rays, and so it
        includes the correlation of paths. An unknown id raises `MistrayError`.
        """
        ids = np.unique(self.check_ids(path_ids))
        _, se = sum_of_runs([own.sums[:, :, ABSORBED].sum(axis=0) for own in self.located(ids)], self.runs)
        return float(self._columns["power_W"][ids].sum()), float(se)

    def ids(self, direct: bool, wavelength_nm: float | None = None) -> np.ndarray:
        """
        Return the ids of all direct paths if `direct`, else of all stray ones, (n,).

        With `wavelength_nm`, nm, only paths of that wavelength count; None: those of all wavelengths.
        """
        chosen = (self._columns["kind"] == DIRECT) == direct
        if wavelength_nm is not None:
            chosen &= self._columns["wavelength_nm"] == wavelength_nm
        return np.flatnonzero(chosen)

    def light(self, path_ids: int | Sequence[int] | np.ndarray) -> Sampled:
        """Return the total power of some paths as `power` does, W, but with noise by batch: errors stay correlated."""
        return self._numbers.light[np.unique(self.check_ids(path_ids))].total()

    @property
    def stray_W(self) -> Estimate:
        """Total power of all stray paths on the detectors, W, with its standard error."""
        return Estimate(*self.light(self.ids(direct=False)).whole)

    def numbers(self, groups: int | Sequence[int | Sequence[int]]) -> PathNumbers:
        """
        Return power, centroid, radius and polarisation, with each group of paths treated as one path, in their order.

        `groups` holds path ids, each a group of its own, or lists of at least one path id, of which each counts once.
        """
        groups = self._groups(groups)
        counts = np.array([len(group) for group in groups], dtype=np.int64)
        heads = np.array([group[0] for group in groups], dtype=np.int64)
        # Groups of one path have the numbers of that path; the others are summed in chunks, which bounds the memory
        alone = self._numbers[heads]
        if not len(groups) or counts.max() == 1:
            return alone
        several_rows = np.flatnonzero(counts > 1)
        parts = []
        for chosen in np.array_split(several_rows, -(-len(several_rows) // CHUNK)):
            group = np.repeat(np.arange(len(chosen)), counts[chosen])
            ids = np.concatenate([np.asarray(groups[k], dtype=np.int64) for k in chosen])
            parts.append(path_numbers([self._sums(k, ids, group) for k in np.unique(self._run[ids])]))
        order = np.empty(len(groups), dtype=np.int64)
        order[counts == 1] = np.arange(len(groups) - len(several_rows))
        order[several_rows] = np.arange(len(groups) - len(several_rows), len(groups))
        return PathNumbers.joined([alone[counts == 1], *parts])[order]

    def _groups(self, groups: int | Sequence[int | Sequence[int]]) -> list[list[int]]:
        """Return groups of path ids as lists without repetition; raise `MistrayError` if one is empty or unknown."""
        found = [several(group) for group in several(groups)]
        if not all(found):
            raise MistrayError("a group of paths is empty; give each at least one path_id")
        self.check_ids([path_id for group in found for path_id in group])
        return [list(dict.fromkeys(group)) for group in found]

    def _sums(self, run: int, ids: np.ndarray, group: np.ndarray) -> HitSums:
        """
        Return the flux sums of one run's paths, added up by group of paths.

        `group`, ascending, holds the group index of each of `ids`.
        """
        one, here = self.runs[run], self._run[ids] == run
        sums = np.zeros((int(group[-1]) + 1, *one.paths.sums.shape[1:]))
        np.add.at(sums, group[here], one.paths.sums[self._place[ids[here]]])
        return HitSums(sums, one.started, one.unit)

    def columns_of(self, groups: int | Sequence[int | Sequence[int]]) -> dict[str, np.ndarray]:
        """
        Return the columns of `PathRow` from ``rays`` on, with each group of paths treated as one path.

        Together the groups must be all paths of some sources and kinds.
        """
        groups = self._groups(groups)
        numbers = self.numbers(groups)
        heads = np.array([group[0] for group in groups], dtype=np.int64)
        found = numbers.judged(alike([self._columns[name][heads] for name in SAME_KIND]))
        return found | percents(numbers.light, self._numbers.light.total(), found["few_rays"])

    def moments(self) -> np.ndarray:
        """
        Return the absorbed flux of each path and its first and second moments over the detector.

        Returns
        -------
        (p, 4) float64
            Sums of the flux (W), of flux times x and times y (W mm), and of flux times x² + y² (W mm²); in the
            detector's frame.
        """
        table = np.zeros((len(self), len(MOMENT_SUMS)))
        for own in self.located():
            table[own.ids] = own.run.unit * own.sums.sum(axis=1)[:, MOMENT_SUMS]
        return table

    def by_batch(self, coefficients: np.ndarray) -> np.ndarray:
        """
        Return the sum over all paths of coefficients times `moments`, for each batch of start rays.

        Parameters
        ----------
        coefficients : (p, 4) float64
            Factor of each moment of each path.

        Returns
        -------
        (BATCHES,) float64
            Sum of each batch, in the unit of coefficient times moment.
        """
        total = np.zeros(BATCHES)
        chosen = np.flatnonzero(np.any(coefficients != 0, axis=1))
        for own in self.located(chosen):
            total += own.run.unit * np.einsum("pbk,pk->b", own.sums[:, :, MOMENT_SUMS], coefficients[own.ids])
        return total

    def by_way(self, aliases: Mapping[str, str] | str | None = None) -> pd.DataFrame:
        """
        Return the table with ordinary and aimed scatter merged: one row for each sequence of events.

        Parameters
        ----------
        aliases : mapping of str to str, "part" or "space", optional
            Other names of surfaces: their part, their optical space, or a mapping of patterns to names, see
            `mistray.trace.path_aliases.alias_names`. Consecutive events within one name are one visit, and paths that
            differ in nothing else are one row. A row still has one `kind`, and all its light the same number of
            reflections and scatter events.

        Returns
        -------
        DataFrame
            Columns of `to_pandas`, strongest first, with the letters t and r for all scattered light, and ``path_ids``,
            the tuple of the `path_id` of a row; its own ``path_id`` is the strongest of them. The numbers of a row come
            from the sums of its paths in the ledger.

        Raises
        ------
        MistrayError
            As `mistray.trace.path_aliases.alias_names` does.
        """
        if aliases is None:
            return self._by_way.copy()
        return self._merged(aliases)

    @cached_property
    def _by_way(self) -> pd.DataFrame:
        """Table of `by_way` without aliases, cached because several parts of a report read it."""
        return self._merged(None)

    def _merged(self, aliases: Mapping[str, str] | str | None) -> pd.DataFrame:
        """Return the table of `by_way` for given aliases, None for none; raise as `by_way` does."""
        table = {name: column.copy() for name, column in self._columns.items()}
        for name, text in (("events", way_text), ("path", way_letters)):
            table[name][:] = text(table[name])
        # Facts that aliases must not merge: they enter the key of a way
        apart = np.zeros((len(self), 0), dtype=np.uint32)
        if aliases is not None:
            numbers = [np.unique(self._columns[name], return_inverse=True)[1] for name in KEPT_APART]
            apart = np.stack(numbers, axis=1).astype(np.uint32)
        head = np.arange(len(self))  # the strongest path of the same way
        # Without scatter and aliases a path is a way of its own
        merged = np.flatnonzero((self._columns["scatters"] > 0) | (aliases is not None))
        for own in self.located(merged):
            ids, events = own.ids, own.events
            events = replace(events, codes=way(events.codes))
            if aliases is not None:
                names = alias_names(own.run.table, aliases)
                events, columns = aliased(events, names)
                of = dict(zip(own.run.table.event_ids, names, strict=True))
                columns |= {name: np.array([of.get(v, v) for v in self._columns[name][ids]], object) for name in NAMES}
                for name, values in columns.items():
                    table[name][ids] = values
            # Group paths of equal events, and name each group
            keys = host_keys(np.hstack([apart[ids], events.codes]), events.lengths + apart.shape[1])
            _, first, group = np.unique(keys, return_index=True, return_inverse=True)
            head[ids] = ids[first][group]
            table["label"][ids[first]] = events[first].labels(self._columns["kind"][ids[first]])
        # Numbers of the groups
        order = np.argsort(head, kind="stable")
        kept, starts = np.unique(head[order], return_index=True)
        ways = [tuple(ids.tolist()) for ids in np.split(order, starts[1:])] if len(kept) else []
        table = {name: column[kept] for name, column in table.items()} | self.columns_of(ways)
        table["key"][:] = event_keys(table["events"])
        strongest = np.argsort(-table["power_W"], kind="stable")
        found = _frame({name: column[strongest] for name, column in table.items()})
        return found.assign(path_ids=[ways[k] for k in strongest])

    def to_pandas(self) -> pd.DataFrame:
        """Return the table as a DataFrame: a row for each path, a column for each attribute of `PathRow`."""
        return _frame(self._columns)

    def to_csv(self, path: str | Path) -> None:
        """Write the path table as CSV, numbers with nine digits."""
        self.to_pandas().to_csv(path, index=False, float_format="%.9g")

    def to_parquet(self, path: str | Path) -> None:
        """
        Write the path table as Parquet (extra ``tables``), with units.

        See `mistray.report.write_parquet`, also for errors.
        """
        from mistray.files.parquet import write_parquet

        write_parquet(self.to_pandas(), path)

    def __str__(self) -> str:
        lines = [f"{'id':>4} {'power W':>12} {'± se':>9} {'% of all':>9} {'rays':>9} {'rms mm':>10} {'kind':<20} path"]
        for row in self[:ROWS_PRINTED]:
            lines.append(
                f"{row.path_id:>4} {row.power_W:>12.5e} {row.power_se_W:>9.1e} {row.percent:>9.4g} {row.rays:>9} "
                f"{row.rms_radius_mm:>10.4g} {row.kind:<20} {row.label}"
            )
        more = self._columns["percent"][ROWS_PRINTED:]
        lines += [f"… and {len(more)} more, together {more.sum():.4g} % of all"] if len(more) else []
        return "\n".join(lines)


def _frame(columns: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Return the columns of a path table as a DataFrame; text columns get the pandas string type."""
    import pandas as pd

    text = {name: column.tolist() for name, column in columns.items() if column.dtype == object}
    return pd.DataFrame({**columns, **text})


def path_table(runs: Sequence[Run]) -> PathTable:
    """Return the table of the paths that reach the detectors, from runs traced with a ledger."""
    parts, places, numbers = [], [], []
    for run in runs:
        place = np.flatnonzero(run.paths.sums[:, :, RAYS].any(axis=1))
        own = LocatedPaths(run, place, place)
        events = own.events
        numbers.append(path_numbers([HitSums(own.sums, run.started, run.unit)]))
        # The last event of a path is at its detector
        ends = run.design.ends(events.codes, events.lengths)
        parts.append(
            {
                "source": np.full(len(place), run.source.name, dtype=object),
                "wavelength_nm": np.full(len(place), run.source.wavelength_nm),
                "detector": np.array(events.ids, dtype=object)[ends],
            }
            | describe_events(events)
        )
        places.append(place)
    found = PathNumbers.joined(numbers)
    # Errors are judged by kind over all runs, so that a path of few rays has those of its kind beside it
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    columns |= found.judged(alike([columns[name] for name in SAME_KIND]))
    number = np.repeat(np.arange(len(places)), [len(place) for place in places])
    # By power; equal ones by source, wavelength and events, whatever the order of the shapes in the file
    keys = list(zip((-columns["power_W"]).tolist(), number.tolist(), columns["events"], strict=True))
    order = np.array(sorted(range(len(keys)), key=keys.__getitem__), dtype=np.int64)
    columns = {name: column[order] for name, column in columns.items()}
    columns["path_id"] = np.arange(len(order))
    columns |= percents(found.light[order], found.light.total(), columns["few_rays"])
    return PathTable(columns, runs, number[order], np.concatenate(places)[order], found[order])
