"""Texts of all notes on results; docs/warnings.md lists the remedies by code."""

from __future__ import annotations

from enum import Enum
from typing import Any

from mistray.notes import Code, Note
from mistray.settings import BRANCHES

# What has become of light that was not followed, by the reasons of the energy ledger; completed by the settings
CUTS = {
    "flux_threshold": "cut by flux_threshold = {flux_threshold:g} (after scatter: scatter_threshold = "
    "{scatter_threshold:g}); lower it, or use below_threshold = roulette",
    "max_reflections": "not followed beyond max_reflections = {max_reflections}; raise it to see where it goes",
    "max_scatters": "not scattered: max_scatters = {max_scatters} or another limit of scatter; raise it to see where "
    "it goes",
    "max_generations": "not followed beyond max_generations = {max_generations}; raise it to see where it goes",
    "max_events": "cut by max_events = {max_events}; ",
    "max_consecutive": "cut by max_consecutive = {max_consecutive}; raise it to see where it goes",
    "ray_control": "refused by ray_control = {ray_control}",
    "max_segments": "left of trees of more than max_segments = {max_segments} ray segments; lower max_reflections or "
    "max_scatters, or raise it",
    **{
        f"{branch}_below": f"below the cut_below limit of {branch.replace('_', ' ')}; lower it"
        for branch in BRANCHES.values()
    },
    "medium": "lost where a ray met a surface from the wrong material; the geometry has a gap or an overlap, or a "
    "surface has front and back exchanged",
}


class Message(Enum):
    """Template of a note on a result: its code, and a text with placeholders for numbers and names."""

    # Light that was not followed
    CUT = Code.CUT, "up to {share:.1e} of the launched flux was {what}"
    LOST = Code.MEDIUM, "up to {share:.1e} of the launched flux was {what}"
    VIEW_CUT = (
        Code.CUT,
        "{share} of what the detector sees was not followed to its source; raise max_reflections and max_scatters, or "
        "set below_threshold to roulette",
    )
    VIEW_LOST = (
        Code.MEDIUM,
        "up to {share:.1e} of the light met a surface from the wrong material, or left the scene within a lens; look "
        "for a gap, an overlap or a missing edge",
    )
    OPEN = Code.CLOSURE, "the energy closes to {value:.1e} only, not to {limit:g}"

    # The scene
    COARSE_COATING = (
        Code.COATING,
        "R of a coating in total reflection varies too fast with the angle for its table; the error is up to "
        "{value:.1e}",
    )
    UNFITTED_PRESET = Code.COATING, "{what}"
    THIN_GAP = (
        Code.THIN_GAP,
        "surfaces '{first}' and '{second}' are {gap:.2g} mm apart; rays are placed to {least:.2g} mm there, "
        "{place:.4g} mm from the middle: light may be lost; trace these parts alone",
    )
    CLEAR_METAL = (
        Code.MATERIAL,
        "the metal {medium} {where} {surface} is taken as opaque, though {passed:.1g} of the light at {nm:g} nm would "
        "pass its {length:.2g} mm; make it a layer of a coating",
    )
    OPAQUE_MEDIUM = (
        Code.MATERIAL,
        "{medium} {where} {surface} is taken as opaque: no light at {nm:g} nm gets through {why}",
    )
    INFERRED_MEDIUM = (
        Code.MATERIAL,
        "the detector is taken to be in '{medium}', because surface '{surface}' declares it; say so by {side} of the "
        "detector",
    )
    UNDECLARED_IMAGE = (
        Code.DESIGN_PATH,
        "detector '{detector}': no design path leads to it, and {share} of its light comes by {path}; if that is the "
        'image, declare design_path="{path}" at the detector',
    )
    NO_DESIGN = (
        Code.DESIGN_PATH,
        "no design path to '{detector}' was found: its image is all light that is neither scattered nor a ghost; "
        "declare design_path where that is not so",
    )
    NO_OPTICS = (
        Code.DESIGN_PATH,
        "no light of the scene's source reaches the detector, or there is no source: without a design path no surface "
        "counts as an optic, and places are not known",
    )
    OUTSIDE_SEEN = (
        Code.OUTSIDE_SEEN,
        "the detector sees the outside {way}: {share:.2g} of its view, field angles {low:.3g} to {high:.3g}°",
    )
    MORE_OUTSIDE = Code.OUTSIDE_SEEN, "… and in {count} more ways"
    CLOSED_IN = Code.CLOSED_IN, "no ray from the detector leaves the scene: it is closed in, or the rays are too few"

    # No light
    DARK = Code.NO_LIGHT, "no light reaches the detector: {loss} of it"
    DARK_ANGLES = (
        Code.NO_LIGHT,
        "no light was seen at {angles} in {rays:.3g} rays. That sets no upper limit: a path that rays seldom find can "
        "carry light. If more rays see none either, the detector may be closed in, or limits cut all paths",
    )
    DARK_ON_AXIS = Code.NO_LIGHT, "no direct light reaches the detector on axis: nothing can be normalised to it"
    NO_SCENE_SEEN = (
        Code.NO_LIGHT,
        "the detector sees no scene: no ray leaves the system without a ghost reflection or scatter",
    )

    # Time
    FEWER_RAYS = (
        Code.UNFINISHED,
        "{rays:.4g} of {planned:.4g} rays were traced; errors are those of the rays traced{more}",
    )
    NOT_TRACED = Code.UNFINISHED, "{what}"
    FEWER_WAVELENGTHS = Code.WAVELENGTHS, "{what}; {instead}"

    # Sampling of scattered light
    AIMED_MISS = (
        Code.AIMED,
        "few aimed rays reach the detector (less than {limit:g} %): {names}. Give these surfaces a smaller target or "
        "several; where only a lens is in view, more is not possible",
    )
    TIGHT_TARGETS = (
        Code.TARGET,
        "every aimed ray reaches the detector: {names}. These targets may be too small; enlarge them until some rays "
        "miss",
    )
    SILENT = (
        Code.SILENT,
        "{count} light, but none of it reaches the detector: {names} (share of the launched flux). If the detector "
        "sees such a place, give it a target or raise rays",
    )
    FEW_SCATTERED = (
        Code.SCATTERED_RAYS,
        "only {value:.2g} scattered rays reach the detector per start ray (at least {limit:g} is good); raise "
        "aimed_rays, or give the surfaces that scatter a target",
    )
    MANY_SCATTERED = (
        Code.SCATTERED_RAYS,
        "{value:.3g} scattered rays reach the detector per start ray (at most {limit:g} is good); trace more start "
        "rays with fewer scattered ones: lower aimed_rays or scatter_rays, or raise scatter_threshold",
    )
    ONE_RAY = (
        Code.ONE_RAY,
        "one ray carries {value:.3g} % of the scattered light (at most {limit:g} % is good); raise rays, or give the "
        "surface that scattered it a target",
    )
    ONE_RAY_AT_ANGLES = (
        Code.ONE_RAY,
        "single rays carry more than {limit:g} % of the scattered light at {angles}; errors there may be too low, take "
        "more rays",
    )

    # Errors
    FEW_RAYS = Code.FEW_RAYS, "some of the worst four paths hold too few rays for an error; raise rays"
    CONTESTED = (
        Code.CONTESTED,
        "which path is the worst is open, path {path_id} may be as bright; raise rays",
    )
    LARGE_ERROR = Code.ERROR, "standard error up to {worst} at {angles}; give more rays"
    ERROR_LEFT = Code.ERROR, "errors of up to {worst} are left where {requested} was requested; {remedy}"
    POLARIZATION = Code.POLARIZATION, "polarization: {reason}; this is of light that is unpolarised at every hit"
    BAND_ERROR = (
        Code.BAND,
        "the optics were traced at {count} wavelengths, between which they differ: integrals over the band have an "
        "error of {error}; leave wavelengths_um (--wavelength-um) out",
    )
    BAND_UNKNOWN = (
        Code.BAND,
        "the optics are not known all over the band: how well these wavelengths stand for it is not known",
    )
    BAND_OUTSIDE = (
        Code.BAND,
        "the optics were traced at {wavelengths} µm, outside the band: their emissivity there is taken for that in "
        "the band",
    )

    # Names of paths
    SEVERAL_PATHS = Code.SEVERAL_PATHS, "'{name}' means {count} paths together: {listed}"
    NO_PATH = Code.NO_PATH, "no light of this trace goes by '{name}'{near}"

    def note(self, warns: bool = True, /, **facts: Any) -> Note:
        """
        Return the note with its placeholders filled in by `facts`.

        `warns`: True if it is also raised as a warning.
        """
        code, text = self.value
        return Note(text.format(**facts), code, warns)


def fewer_rays(rays: float, planned: float, more: str = "") -> Note:
    """Return the note that a result has `rays` instead of `planned` start rays; `more` is appended to its text."""
    return Message.FEWER_RAYS.note(rays=rays, planned=planned, more=more)
