"""One path of light from a source to a detector, as a row of the path table."""

from __future__ import annotations

from dataclasses import dataclass

from mistray.events import INTERCEPTS, LETTERS
from mistray.ids import event_words


@dataclass(frozen=True)
class PathRow:
    """
    Path from a source to the detector. Every number with ``_se`` after it is that number's standard error.

    Attributes
    ----------
    path_id : int
        Rank by power, 0 is the strongest.
    source : str
        Id of the source.
    wavelength_nm : float
        Vacuum wavelength, nm.
    detector : str
        Id of the detector where the path ends.
    key : str
        Hash of the events, ten hexadecimal digits, the same in every table: `mistray.recorders.path_events.event_keys`.
    label : str
        Name of the path by its events and the scene, the same in every table, see
        `mistray.recorders.path_events.PathNames`. Light of another source or wavelength that meets the same events has
        the same name.
    events : str
        Surfaces and events, ``L1_front:T L1_rear:R … detector:A``; T transmitted, R reflected, I totally internally
        reflected, A absorbed; scattered or diffracted at random: t in transmission, r in reflection; towards a target:
        i in transmission, j in reflection. Random and aimed scatter are techniques for the same light, with MIS
        weights: only both together are the flux on a detector, see `PathTable.by_way`.
    path : str
        Letters of the events alone.
    order : int
        Number of ghost reflections: at refracting surfaces and at the detector, without mirrors and total reflection.
    kind : str
        "direct": a sequence of the design, see docs/design_path.md. "straight shot": any other sequence that reflects
        only where the design does. "ghost". "structure": specular reflections at opaque surfaces that are not mirrors.
        "structure+ghost". "TIR": total reflection where the design has none. Paths that scatter: "single scatter",
        "multiple scatter", or, with specular reflections counted in ``ghost_1``, "ghost + scatter". Paths that an edge
        diffracts: "edge diffraction", or, with scatter or such reflections, "diffraction + others". Light that the
        instrument itself emits has no source and no path here, see `mistray.thermal`.
    ghost_1, ghost_2 : str
        First and second surface that reflects specularly, without mirrors and total internal reflection; "-" if there
        is none.
    scatter_1 : str
        First surface that scatters or diffracts; "-" if there is none.
    edges : str
        Edges, bevels and flanges of lenses that the light meets, in this order, separated by spaces, or "-" if there
        are none.
    scatters : int
        Number of scatter events, including diffraction.
    diffractions : int
        Number of scatter events at rings that carry ``edge_diffraction``.
    structure_bounces, tir : int
        Number of specular reflections at structure, and of total internal reflections.
    objects, unique_objects : int
        Number of surfaces that are met, including the detector: all hits, or each surface once. A body that scatters
        counts as a surface.
    last_object : str
        Last surface before the detector; "-" if there is none.
    critical : str
        Critical surface: the last that scatters or diffracts the light or is a ghost's or a structure's reflection, so
        that the detector sees it lit; "-" if there is none.
    rays : int
        Number of hits of the detector.
    effective_rays : float
        Effective number of hits, (Σw)²/Σw² with the flux w of each: so many of equal flux have the same relative error.
    error_rays : float
        (Σw²)²/Σw⁴, the number of rays that the standard error of the power stands on, or that number with the weights
        of the paths of the same kind, where it is less: see `mistray.trace.path_numbers.PathNumbers.judged`.
    few_rays : bool
        Whether `error_rays` is less than `mistray.recorders.sampled.ERROR_RAYS`, so that there is no error: the errors
        of this row are NaN. The sum of several such rows has one, see `PathTable.power`.
    power_W : float
        Flux that the detector absorbs, W.
    incident_W : float
        Flux that reaches the detector, W.
    percent : float
        Percentage of the power of all paths. Its error includes the correlation with that power: it comes from the
        spread of the batches of start rays.
    x_mm, y_mm : float
        Centroid of the absorbed flux in the detector's frame, mm.
    rms_radius_mm : float
        RMS distance of the absorbed flux from its centroid, mm.
    rms_irradiance_W_mm2 : float
        power / (π · rms_radius²), W/mm²; NaN for a single ray.
    polarization : float
        Degree of polarisation of all light of the path together, 0 … 1; NaN if traced unpolarised.
    s1, s2, s3 : float
        Normalised Stokes vector (S1, S2, S3)/S0: linear along the world's x as seen across the ray (along y where the
        ray is within 26° of x), linear at 45° from there, and circular, clockwise as the detector sees it; see
        docs/polarization.md.

    Examples
    --------
    >>> t = mistray.trace(mistray.load("cooke_triplet"), rays=10_000)
    >>> t.paths[1].kind, t.paths[1].path
    ('ghost', 'TTRRTTTTA')
    """

    path_id: int
    source: str
    wavelength_nm: float
    detector: str
    key: str
    label: str
    events: str
    path: str
    order: int
    kind: str
    ghost_1: str
    ghost_2: str
    scatter_1: str
    edges: str
    scatters: int
    diffractions: int
    structure_bounces: int
    tir: int
    objects: int
    unique_objects: int
    last_object: str
    critical: str
    rays: int
    effective_rays: float
    error_rays: float
    few_rays: bool
    power_W: float
    power_se_W: float
    incident_W: float
    incident_se_W: float
    percent: float
    percent_se: float
    x_mm: float
    x_se_mm: float
    y_mm: float
    y_se_mm: float
    rms_radius_mm: float
    rms_radius_se_mm: float
    rms_irradiance_W_mm2: float
    rms_irradiance_se_W_mm2: float
    polarization: float
    polarization_se: float
    s1: float
    s1_se: float
    s2: float
    s2_se: float
    s3: float
    s3_se: float

    @property
    def event_list(self) -> list[tuple[str, str]]:
        """
        Events of the path in order, pairs of the id of a surface or medium and the type of event.

        The types are SpecTran, SpecRefl, TIR, RandTran, RandRefl, ImpTran, ImpRefl and Absorbed.
        """
        names = {LETTERS[code]: name for code, name in INTERCEPTS.items()}
        return [(name, names[letter]) for name, letter in (event.rsplit(":", 1) for event in event_words(self.events))]
