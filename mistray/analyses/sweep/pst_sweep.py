"""PST of a scene before and after edits: moves, blocks, paint and coatings."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np

from mistray.analyses.pst.metrics.first_light import first_light
from mistray.analyses.pst.result import Pst
from mistray.analyses.pst.run import pst_of_each
from mistray.analyses.sweep.configurations import AS_IT_IS, Configuration, Given, as_configurations
from mistray.analyses.sweep.numbers import entering_columns, widest
from mistray.analyses.sweep.original import Original
from mistray.analyses.sweep.request import EditsRequest
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.known_arguments import known_arguments
from mistray.metrics.changes.first_surfaces import Entering, entering_text, spoils
from mistray.metrics.changes.gaps import Contacts, Gap, gaps_text
from mistray.metrics.views import TraceView, seen_unpolarized
from mistray.ranges import several
from mistray.result import KeyNumber, Result
from mistray.toolkit.analysis import analysis

if TYPE_CHECKING:
    import pandas as pd

Progress = Callable[[float, float], None]


@dataclass(frozen=True)
class Changed:
    """
    Effect of an edit on the PST at one field angle: before, after and ratio.

    Attributes
    ----------
    before, before_se, after, after_se : float
        PST before and after, and their standard errors, dimensionless.
    ratio, ratio_se : float
        After over before, dimensionless; the error allows for the common random numbers of both runs, from the batches
        of start rays, and is smaller than that of independent runs. NaN if there was no light before.
    entering : tuple of Entering
        Surfaces that light newly meets first on its way to the detector after the edit, with their shares of it,
        the strongest first. Empty for PSTs that were computed without paths.
    """

    before: float
    before_se: float
    after: float
    after_se: float
    ratio: float
    ratio_se: float
    entering: tuple[Entering, ...] = ()

    @property
    def gain(self) -> bool:
        """True if the light decreases, and new first surfaces do not spoil this: `entering` is small, see `spoils`."""
        return self.ratio < 1 and not spoils(self.entering)


class PstSweep(Result, table=".edit_tables:pst_sweep_table", figure=".edit_figures:pst_sweep_figure"):
    """
    Result of `sweep_pst`: PST of each configuration by field angle.

    Attributes
    ----------
    configurations : tuple of str
        Names of the configurations; the first is that of the original scene.
    field_deg : (n,) float64
        Field angles, degrees.
    pst : dict of str to Pst
        PST by configuration, dimensionless, at the n field angles.
    gaps : dict of str to tuple of Gap
        Surfaces that meet in the original scene and are apart in a configuration, by configuration, see
        `mistray.metrics.changes.gaps`.
    unpolarized : dict of str to list of str
        Changes of more than 1 % that Stokes vectors would make, by configuration, see
        `mistray.trace.host.polarization_choice.unpolarized_notes`.

    Examples
    --------
    >>> coated = mistray.sweeps.Configuration("coated", coat={"L1": "bbar3"})
    >>> found = mistray.sweeps.sweep_pst("lens_and_window", [coated], [10, 30], rays=20_000)
    >>> found.configurations
    ('as it is', 'coated')
    >>> print(f"{found.changed('coated', 10).ratio:.3f} of the stray light is left")
    0.001 of the stray light is left
    """

    def __init__(
        self,
        found: Mapping[str, Pst],
        gaps: Mapping[str, tuple[Gap, ...]] | None = None,
        unpolarized: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        self.pst = dict(found)
        self.unpolarized = {name: list((unpolarized or {}).get(name, ())) for name in found}
        self.gaps = {name: tuple((gaps or {}).get(name, ())) for name in found}
        self.configurations = tuple(found)
        self.field_deg = next(iter(found.values())).field_deg

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of angles, and for each configuration the stray PST at the last one, after over before."""
        found: dict[str, KeyNumber] = {"angles": len(self.field_deg)}
        for name in self.configurations[1:]:
            change = self.changed(name, float(self.field_deg[-1]))
            found[f"{name} after/before at {self.field_deg[-1]:g}° [1]"] = Estimate(change.ratio, change.ratio_se)
        return found

    @known_arguments
    def changed(self, configuration: str, field_deg: float, classes: str | Sequence[str] = "stray") -> Changed:
        """
        Return the effect of a configuration at one field angle.

        Parameters
        ----------
        configuration : str
            Name of the configuration.
        field_deg : float
            Field angle, degrees, one of `field_deg`.
        classes : str or sequence of str
            "stray", "total" or classes of light, see `Pst.samples`.

        Raises
        ------
        MistrayError
            If there is no such configuration or angle.
        """
        if configuration not in self.pst:
            raise MistrayError(f"PST sweep: no configuration '{configuration}'; choose from {', '.join(self.pst)}")
        places = np.flatnonzero(np.isclose(self.field_deg, field_deg))
        if len(places) != 1:
            listed = ", ".join(f"{angle:g}" for angle in self.field_deg)
            raise MistrayError(f"PST sweep: no field angle {field_deg:g}°; choose from {listed}")
        at, classes = int(places[0]), several(classes)
        first, other = self.pst[self.configurations[0]], self.pst[configuration]
        (b, b_se), (a, a_se) = ((float(x[at]) for x in one.curve(classes)) for one in (first, other))
        entering = first_light(other, at).since(first_light(first, at))
        if b == 0:
            return Changed(b, b_se, a, a_se, float("nan"), float("nan"), entering)
        # d(a/b) = (da - (a/b) db)/b, batch by batch; azimuths have rays of their own where each cell has
        parts = (other.samples(classes)[at] - a / b * first.samples(classes)[at]) / b
        weight = first.weight if first.weight.ndim == 1 else first.weight[at]
        if first.weight.ndim == 1:
            _, se = Pst.estimate(parts.mean(axis=0), weight)
        else:
            _, each = Pst.estimate(parts, weight)
            se = np.sqrt(np.sum(each**2)) / len(each)
        return Changed(b, b_se, a, a_se, a / b, float(se), entering)

    @property
    def warnings(self) -> list[str]:
        """
        Warnings on the reliability of the PSTs.

        They name gaps that a configuration opens, light that enters by new first surfaces, angles at which no stray
        light was seen, and changes that Stokes vectors would make.
        """
        found = [f"{name}: {gaps_text(gaps)}" for name, gaps in self.gaps.items() if gaps]
        dark: dict[str, list[str]] = {}
        for name, one in self.pst.items():
            if angles := ", ".join(f"{angle:g}" for angle in self.field_deg[one.curve("stray")[0] == 0]):
                dark.setdefault(angles, []).append(name)
        found += [
            f"no stray light was seen at {angles} deg ({'; '.join(names)}); that sets no upper limit: give more rays, "
            "or higher max_scatters and max_reflections"
            for angles, names in dark.items()
        ]
        for name in self.configurations[1:]:
            for angle in self.field_deg:
                change = self.changed(name, float(angle))
                if change.entering:
                    no_gain = f"; {change.ratio:.3g} is no gain" if change.ratio < 1 and not change.gain else ""
                    found.append(f"{name} at {angle:g} deg: {entering_text(change.entering)}{no_gain}")
        return found + [f"{name}: {note}" for name, notes in self.unpolarized.items() for note in notes]

    def to_pandas(self, classes: str | Sequence[str] = "stray") -> pd.DataFrame:
        """
        Return a row for each configuration except the first, and field angle, as a frame.

        Returns
        -------
        DataFrame
            Columns configuration, angle_deg, before, before_se, after, after_se, ratio, ratio_se; entering (surfaces by
            which light enters that did not before, separated by spaces), entering_percent, entering_percent_se (their
            percentage of the light after), gain (see `Changed.gain`), gap_mm (the widest gap that the configuration
            opens; NaN without any).
        """
        import pandas as pd

        rows, classes = [], several(classes)
        for name in self.configurations[1:]:
            for angle in self.field_deg:
                change = self.changed(name, float(angle), classes)
                row = {"configuration": name, "angle_deg": float(angle), **vars(change)}
                opened = {"gain": change.gain, "gap_mm": widest(self.gaps[name])}
                rows.append(row | entering_columns(change.entering) | opened)
        return pd.DataFrame(rows)


def run(
    scene: str | Path | mi.Scene, request: EditsRequest, *, configurations: Given, progress: Progress | None = None
) -> PstSweep:
    """
    Return the PST of a scene as it is and in each configuration, with common random numbers.

    All runs use the same method, directions and numbers of rays, and forward rays cover the surfaces of all
    configurations. So light that an edit does not touch is the same in all, ray by ray.

    Parameters
    ----------
    scene : str, Path or mi.Scene
        Scene XML file, the name of a shipped scene, or a scene from `mistray.load` with its values as they are now,
        which stays as it is.
    request : EditsRequest
    configurations : mapping of str to mapping, Configuration or sequence of Configuration
        Changes of the scene; a mapping gives values of parameters only.
    progress : callable, optional
        Called after every PST with (PSTs done, PSTs to do).

    Returns
    -------
    PstSweep

    Raises
    ------
    MistrayError
        If a configuration names something that the scene lacks, makes surfaces overlap or is impossible; if an argument
        is unknown; if a loaded scene is not from `mistray.load`, or is to be painted, coated or blocked although it has
        no file or other values than its file; or for any reason of `mistray.pst`.

    Examples
    --------
    >>> coated = mistray.sweeps.Configuration("coated", coat={"L1": "bbar3"})
    >>> found = mistray.sweeps.sweep_pst("lens_and_window", [coated], [10, 30], rays=20_000)
    >>> for row in found.to_pandas().itertuples():
    ...     print(f"{row.angle_deg:.0f}°: {row.before:.1e} before, {row.after:.1e} after")
    10°: 4.8e-05 before, 4.1e-08 after
    30°: 3.9e-05 before, 3.3e-08 after
    """
    wanted = as_configurations(configurations)
    if any(one.name == AS_IT_IS for one in wanted):
        raise MistrayError(
            f"configuration '{AS_IT_IS}': this name is that of the scene without changes; choose another"
        )
    every = [Configuration(AS_IT_IS), *wanted]
    at: list[str] = []  # the configuration that is being made, for messages
    gaps: dict[str, tuple[Gap, ...]] = {}
    unpolarized: dict[str, Sequence[str]] = {}
    own = {"field_deg": request.field_deg, "rays": request.rays}
    view = TraceView({**own, **request.light, **request.settings})

    def scenes(original: Original) -> Iterator[mi.Scene]:
        contacts = None
        for one in every:
            at[:] = [f"configuration '{one.name}': "]
            edited = original.edited(one)
            contacts = Contacts(edited) if contacts is None else contacts
            gaps[one.name] = contacts.opened(edited)
            unpolarized[one.name] = seen_unpolarized(edited, [view])
            yield edited
        at.clear()

    found: dict[str, Pst] = {}
    try:
        with tempfile.TemporaryDirectory() as folder:
            each = scenes(Original(scene, Path(folder)))
            for one, result in zip(every, pst_of_each(each, request), strict=True):
                found[one.name] = result
                if progress is not None:
                    progress(len(found), len(every))
    except MistrayError as error:
        error.args = ("".join(at) + str(error).removeprefix("".join(at)),)
        raise
    return PstSweep(found, gaps, unpolarized)


sweep_pst = analysis("sweep_pst", EditsRequest, run, ("configurations", "field_deg"))
