"""Public names of metrics, gradients, tolerances and design, re-exported."""

# Written by tests/stubs.py from what the functions are when they run

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mistray.analyses.budget.result import Budget as Budget
from mistray.analyses.budget.run import budget as budget
from mistray.analyses.fit.run import Evaluations as Evaluations
from mistray.analyses.fit.run import Fit as Fit
from mistray.analyses.fit.run import fit as fit
from mistray.analyses.optimize.study.comparison import Comparison as Comparison
from mistray.analyses.optimize.study.comparison import Levels as Levels
from mistray.analyses.optimize.study.comparison import compare as compare
from mistray.analyses.optimize.study.comparison import measure as measure
from mistray.analyses.optimize.study.model import CoatingGroup as CoatingGroup
from mistray.analyses.optimize.study.model import DesignStudy as DesignStudy
from mistray.analyses.optimize.study.model import Moved as Moved
from mistray.analyses.optimize.study.model import Optimizer as Optimizer
from mistray.analyses.optimize.study.model import Study as Study
from mistray.analyses.optimize.study.model import Term as Term
from mistray.analyses.optimize.study.model import VariableGroup as VariableGroup
from mistray.analyses.optimize.study.optimization import Optimization as Optimization
from mistray.analyses.optimize.study.state import Start as Start
from mistray.analyses.optimize.study.state import Step as Step
from mistray.analyses.optimize.toml.read_study import read_study as read_study
from mistray.analyses.pst.metrics.pst_bands import Modelled as Modelled
from mistray.analyses.pst.metrics.pst_bands import PstBands as PstBands
from mistray.analyses.pst.metrics.pst_metrics import pst_band as pst_band
from mistray.analyses.pst.metrics.pst_metrics import pst_bin as pst_bin
from mistray.analyses.pst.metrics.pst_metrics import pst_mask as pst_mask
from mistray.analyses.pst.metrics.pst_metrics import veiling_glare as veiling_glare
from mistray.analyses.pst.metrics.pst_observation import PstObservation as PstObservation
from mistray.analyses.sensitivity.result import Sensitivity as Sensitivity
from mistray.metrics.bodies import Body as Body
from mistray.metrics.bodies import bodies as bodies
from mistray.metrics.combined_metric import combine as combine
from mistray.metrics.gradient import Gradient as Gradient
from mistray.metrics.gradient import gradient as gradient
from mistray.metrics.metric import Metric as Metric
from mistray.metrics.metric import ghost_focus as ghost_focus
from mistray.metrics.metric import ghost_rms_irradiance as ghost_rms_irradiance
from mistray.metrics.metric import ghost_to_signal as ghost_to_signal
from mistray.metrics.metric import image_metric as image_metric
from mistray.metrics.metric import log as log
from mistray.metrics.metric import path_power as path_power
from mistray.metrics.metric import peak_irradiance as peak_irradiance
from mistray.metrics.metric import relative_illumination as relative_illumination
from mistray.metrics.metric import rms_spot as rms_spot
from mistray.metrics.metric import transmission as transmission
from mistray.metrics.observation import Observation as Observation
from mistray.metrics.observation import smooth_maximum as smooth_maximum
from mistray.metrics.observation import smooth_minimum as smooth_minimum
from mistray.metrics.parameters import Parameter as Parameter
from mistray.metrics.parameters import groups as groups
from mistray.metrics.parameters import match as match
from mistray.metrics.parameters import parameters as parameters

__all__ = [
    "Body",
    "Budget",
    "CoatingGroup",
    "Comparison",
    "DesignStudy",
    "Evaluations",
    "Fit",
    "Gradient",
    "Levels",
    "Metric",
    "Modelled",
    "Moved",
    "Observation",
    "Optimization",
    "Optimizer",
    "Parameter",
    "PstBands",
    "PstObservation",
    "Sensitivity",
    "Start",
    "Step",
    "Study",
    "Term",
    "VariableGroup",
    "bodies",
    "budget",
    "combine",
    "compare",
    "fit",
    "ghost_focus",
    "ghost_rms_irradiance",
    "ghost_to_signal",
    "gradient",
    "groups",
    "image_metric",
    "log",
    "match",
    "measure",
    "optimize",
    "parameters",
    "path_power",
    "peak_irradiance",
    "pst_band",
    "pst_bin",
    "pst_mask",
    "read_study",
    "relative_illumination",
    "rms_spot",
    "sensitivity",
    "smooth_maximum",
    "smooth_minimum",
    "transmission",
    "veiling_glare",
]

def optimize(
    scene: str | Path,
    study: str | Path | Mapping[str, Any] | DesignStudy,
    *,
    steps: int | None = None,
    verification_seeds: int = 8,
    next_order: bool = True,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Step, Start], None] | None = None,
    seconds: float | None = None,
) -> Optimization:
    r"""
    Minimise the merit of a study over its variables.

    Every search follows the gradient of the traced merit within the bounds of the variables. The result is a local
    minimum at best; several starts make a better one likely, no more. The measurement of both designs with one more
    event takes at most the time of the first measurement, or that of three seeds. A search may exploit light beyond its
    limits. If one more event changes a term of the result by more than 5 % and two errors, the comparison includes it.

    Parameters
    ----------
    scene : str or Path
        Scene XML file or name of a shipped scene.
    study : str, Path, mapping or DesignStudy
        Study, or its TOML file, or the content of one as a mapping; see docs/optimization.md.
    steps : int, optional
        Most steps of each search, instead of those of the study. 0 … 10000.
    verification_seeds : int, optional
        Seeds on which the result is compared with the given design, at least 2. 2 … 1000.
    next_order : bool, optional
        Measure both designs again with one more scatter event and, apart from that, with one more reflection.
    checkpoint : str or Path, optional
        File that holds the state after every evaluation; None: the state is not kept.
    resume : bool
        Go on from the checkpoint; the result is the same as without interruption.
    progress : callable, optional
        Called after each step with the `Step` and the `Start` of its search.
    seconds : float, optional
        Time for the searches and the comparison, s; the comparison then has fewer seeds, at least 2. Searches that it
        ends can be resumed from the checkpoint.

    Returns
    -------
    Optimization

    Raises
    ------
    MistrayError
        If the study or the scene cannot be used, `resume` lacks a checkpoint or has that of something else, a minimised
        term is 0 or any value is not finite at the start, or the function of a term fails in a trial before the search.
        A later point without a merit only ends its search. An error after the search is reported in the result.

    Examples
    --------
    >>> study = {
    ...     "term": [{"kind": "path_power", "selection": "ghost", "goal": "minimise", "rays": 1000}],
    ...     "coating": [{"name": "ar", "surfaces": ["L1_front"], "layers": "MgF2 80", "thickness_nm": [60, 150]}],
    ... }
    >>> found = mistray.optimize.optimize("lens_and_window", study, steps=2, verification_seeds=2, next_order=False)
    >>> print(f"{found.best.x[0]:.0f} nm instead of {found.steps[0].x[0]:.0f} nm")
    106 nm instead of 80 nm
    """

def sensitivity(
    metric: Metric,
    params: Mapping[str, Any] | None = None,
    keys: str | Sequence[str] | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
    together: str | Sequence[str] = (),
    factor: float = 10.0,
    change: str | Sequence[str] | None = None,
    reach: float = 10.0,
    check: bool = True,
    monte_carlo: int = 0,
    seed: int = 0,
    edges: bool = True,
    edge_width: float | None = None,
    state: str | Path | None = None,
    resume: bool = False,
    seconds: float | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Sensitivity:
    r"""
    Rank the parameters of a scene by the change of ln(metric) per manufacturing tolerance, by one reverse run.

    Changes are proposed within `reach`, because the linear model fails farther away. R and T alone, in which powers of
    paths are polynomials, may go to the ends of their range. Perturbed systems are traced with the seed of the metric.

    Parameters
    ----------
    metric : Metric
        Metric from `mistray.optimize`; its value must be greater than 0.
    params : mi.SceneParameters, optional
        Parameters of the scene; by default ``mi.traverse(metric.scene)``.
    keys : str | Sequence[str], optional
        Keys or patterns such as 'vane_*.r0'; without them all that have a derivative.
    tolerances : Mapping[str, float], optional
        Tolerances by key or pattern in the unit of the parameter, later ones win; without them the usual ones.
    together : str | Sequence[str], optional
        Patterns of parameters that vary together, by one tolerance in the same sense, and count as one: a symmetric
        group, or a property of one batch.
    factor : float, optional
        How much lower the metric shall be. > 1 … 1e6.
    change : str | Sequence[str], optional
        What may be changed to lower the metric; without it coatings, scatter and structure, not the optics.
    reach : float, optional
        Largest change that is proposed, in tolerances; R and T alone have none.
    check : bool, optional
        Trace the changes that are proposed, on other seeds.
    monte_carlo : int, optional
        Number of perturbed systems to trace, at least 2; 0: none. 0 … 1e6.
    seed : int, optional
        Seed of the perturbations. 0 … 4294967295.
    edges : bool, optional
        Count what rays gain and lose at rims.
    edge_width : float, optional
        Width of the zone at a rim in which rays count, over its radius; without it that of the least error. 1e-6 …
        0.5.
    state : str or Path, optional
        File (.npz) for the finished parts: the gradient, the check, and the perturbed systems.
    resume : bool
        Continue from `state`, perhaps with more perturbed systems. The result is that of one uninterrupted run.
    seconds : float, optional
        Time for the whole run, s. A gradient that would take longer, or more than half of it if perturbed systems are
        requested, uses fewer rays of the metric. All that is compared is traced with the same rays.
        `Sensitivity.not_traced` lists what is left out. Not available with workers.
    progress : callable, optional
        Called with the work done so far and the total work.

    Returns
    -------
    Sensitivity

    Raises
    ------
    MistrayError
        If a key is unknown, no parameter has a derivative, an argument is out of range, the state is of another run, or
        the metric is 0, negative or not finite. Also if a beam just fills a rim that one of `keys` or of `together`
        moves; without `keys` such parameters are left out.

    Examples
    --------
    >>> ghosts = mistray.optimize.path_power(mistray.load("lens_and_window"), "ghost", rays=5000)
    >>> found = mistray.sensitivity(ghosts, keys=["detector.bsdf.R", "*.n_back_shift"], check=False)
    >>> for row in found.rows[:2]:
    ...     print(f"{row.label}: {row.change.value:+.1%} for a tolerance of {row.tolerance:.2g}")
    detector.bsdf.R: +9.2% for a tolerance of 0.04
    index of N-BK7: -0.1% for a tolerance of 0.0005
    """
