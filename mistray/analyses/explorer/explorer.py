"""Model behind the live explorer's page and widget: a scene, its controls, and its estimated or traced stray light."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import peek, without_scene_update
from mistray.analyses.explorer.controls import (
    COATING,
    FIELD,
    VALUES,
    WAVELENGTH,
    Control,
    checked,
    coatings_of,
    controls_of,
)
from mistray.analyses.explorer.detail import path_detail
from mistray.analyses.explorer.estimate import OF_FIRST_ORDER, Guess, at_field, guess
from mistray.analyses.explorer.looks import Looks
from mistray.analyses.explorer.page_data import remedy_data, view_data
from mistray.analyses.explorer.request import ExplorerRequest
from mistray.analyses.explorer.saving import Saving
from mistray.analyses.explorer.traced import Traced, traced
from mistray.analyses.ghosts.field_traces import one_for_fields
from mistray.errors import MistrayError
from mistray.estimate import Estimate
from mistray.metrics.gradient import gradient
from mistray.metrics.metric import path_power
from mistray.metrics.scene_values import assign
from mistray.notes import quiet
from mistray.prescription.by_text import BARE
from mistray.sampling.sources import scene_sources, source_emitters
from mistray.scene import Rules, find, load
from mistray.scene.check import check_overlaps
from mistray.scene.coat import coated_text
from mistray.scene.load import load_text
from mistray.surfaces.surfaces import require_one, solid_shapes
from mistray.toolkit.pages.embedded import section_data
from mistray.trace import Trace, trace

FIELD_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)  # traced ahead, where the scene has a field
MOST_RAYS, PILOT_RAYS, TRACE_S = 20_000, 2000, 0.8
FEWEST_RAYS = 1000
GRADIENT_RAYS, COMPILING_RAYS = 1500, 64
QUIET_S, LATER_S = 0.3, 2.0  # without a move before a trace begins, and what is done ahead
SCENES_KEPT = 4


class Explorer:
    """
    Live model of a scene, its controls and its stray light, estimated at once and traced when there is time.

    `move` answers at once. `work` does the slow jobs one by one, in a thread that calls it repeatedly. It traces the
    present state, compiles kernels for other coatings, finds derivatives with respect to shapes, and then traces the
    field angles of the grid.

    Parameters
    ----------
    scene : str, Path or module
        A scene XML file, or a shipped scene.
    field_deg, wavelength_nm, control, rays
        See `mistray.analyses.explorer.request.ExplorerRequest`.
    **settings
        The other attributes of `mistray.trace.Settings`.

    Attributes
    ----------
    path : Path
        Path of the scene file.
    controls : dict of str to Control
        Controls by name.
    state : dict
        Values of the controls by name.
    version : int
        Number of changes of `view` so far.

    Raises
    ------
    MistrayError
        If the scene cannot be loaded or traced, has several detectors, or a pattern matches no parameter.

    Examples
    --------
    >>> explorer = mistray.Explorer("lens_and_window", field_deg=[0.0], rays=2000)
    >>> watts, error = explorer.settle()["stray_W"]
    >>> print(f"{watts:.1f} W of stray light")
    2.7 W of stray light
    >>> watts, error = explorer.move({"coating L1": "bbar3"})["stray_W"]
    >>> print(f"{watts:.1f} W with a coating on L1, estimated at once")
    2.2 W with a coating on L1, estimated at once
    """

    def __init__(
        self,
        scene: str | Path | ModuleType,
        field_deg: float | Sequence[float] | None = None,
        wavelength_nm: float | None = None,
        control: str | Iterable[str] | None = None,
        rays: float | None = None,
        **settings: Any,
    ) -> None:
        request = ExplorerRequest.of(
            field_deg=field_deg, wavelength_nm=wavelength_nm, control=control, rays=rays, **settings
        )
        self.path = find(scene)
        self._scene = load(self.path)
        require_one([shape.id() for shape in solid_shapes(self._scene) if shape.is_sensor()])
        self._settings = dict(request.settings)
        self.fields = self._fields(request.field_deg)
        every = {float(nm) for source in source_emitters(self._scene) for nm in source.wavelengths_nm}
        wavelengths = sorted(every) if wavelength_nm is None else [wavelength_nm]
        # One mode for all states, so that the kernels stay and neighbouring states compare
        light = {**self._settings, **({} if wavelength_nm is None else {"wavelength_nm": wavelength_nm})}
        self._polarization = one_for_fields(self._scene, self.fields or [None], light)
        self.controls = controls_of(self.path, self._scene, self.fields, wavelengths, request.control)
        self._looks = Looks(self._scene, self.controls)
        self.state: dict[str, VALUES] = {name: one.start for name, one in self.controls.items()}
        self.saving = Saving(self.path, self.controls, self._settings)
        self.version = 0
        self.message = ""
        self._changed = threading.Condition()
        self._moved_at = 0.0
        self._traces = 0
        self._busy = ""
        self._traced: Traced | None = None
        self._guess: Guess | None = None
        self._difference: dict[str, Any] | None = None
        self._grid: dict[float, Traced] = {}
        self._uncompiled = _kinds_of_coatings(self.controls)
        self._tried: set[Any] = set()
        self._impossible: set[Any] = set()
        self._widget: Any = None
        self._scenes: OrderedDict[tuple[Any, ...], Any] = OrderedDict()
        self._drawing = section_data(self._scene)
        self._rays = request.rays or self._chosen_rays()

    # -- what answers at once --------------------------------------------------------------------------------------

    def page(self) -> dict[str, Any]:
        """Return the page's constant data as JSON values: title, rays, fields (degrees), controls, section."""
        name = self.path.parent.name if self.path.name == "scene.xml" else self.path.stem
        return {
            "title": name,
            "rays": self._rays,
            "fields": self.fields,
            "controls": [one.plain() for one in self.controls.values()],
            **self._drawing,
        }

    def view(self) -> dict[str, Any]:
        """
        Return the present state as JSON-serialisable values: powers (W), paths and map, estimated or traced.

        They are absent until the first trace has ended.
        """
        with self._changed:
            return self._view()

    def move(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """
        Set controls, and return the view.

        Parameters
        ----------
        values : mapping
            New values of some controls, by name.

        Returns
        -------
        dict
            View, see `view`: an estimate, unless the last trace is of this very state.

        Raises
        ------
        MistrayError
            If a control is unknown or cannot have its value, or a model does not hold there; nothing changes then.
        """
        wanted = checked(self.controls, values)
        with self._changed:
            before, self.state = self.state, {**self.state, **wanted}
            try:
                self._estimate()
            except MistrayError:  # what a model of scatter does not hold for, a material that is not known there
                self.state = before
                raise
            self._moved_at = time.monotonic()
            self.message = ""
            self._note()
            return self._view()

    def reset(self) -> dict[str, Any]:
        """Reset all controls to the values of the scene, and return the view as `move` does."""
        return self.move({name: one.start for name, one in self.controls.items()})

    def detail(self, events: str, source: str | None = None) -> dict[str, Any]:
        """
        Return the details of a path: its rays, its power, and the effect of coatings on the surfaces where it turns.

        Parameters
        ----------
        events : str
            Events of the path, by which the view names it.
        source : str, optional
            Source of its light; needed if several sources light such a path.

        Raises
        ------
        MistrayError
            If the last trace has no such path, or one of each of several sources.
        """
        with self._changed:
            if self._traced is None:
                raise MistrayError("nothing is traced yet; wait for the first trace")
            of, row = self._traced, self._traced.row(events, source)
            guessed = partial(self._guessed, of)
            return path_detail(of, guessed, self.controls, self.state, row, self._drawing["digits"])

    def save_scene(self) -> Path:
        """Write the scene with the present coatings and parameters and return its path; see `Saving.scene`."""
        with self._changed:
            state = dict(self.state)
        return self.saving.scene(state)

    def save_study(self) -> Path:
        """Write a study of the controls that were moved and return its path; see `Saving.study`."""
        with self._changed:
            state = dict(self.state)
        return self.saving.study(state, self._field(state))

    def wait(self, since: int, seconds: float) -> dict[str, Any]:
        """Return the view as soon as it is newer than version `since`, at the latest after `seconds`."""
        with self._changed:
            self._changed.wait_for(lambda: self.version > since, seconds)
            return self._view()

    def _repr_mimebundle_(self, **kwargs: Any) -> Any:
        """Return the representation in Jupyter: the widget, or text if the extra ``widget`` is not installed."""
        if self._widget is None:
            try:
                from mistray.analyses.explorer.widget import ExplorerWidget
            except ImportError:
                return {"text/plain": f"{self!r}; to see it here: pip install 'mistray[widget]'"}
            self._widget = ExplorerWidget(self)
        return self._widget._repr_mimebundle_(**kwargs)

    def __repr__(self) -> str:
        stray = "" if self._guess is None else f", stray light {self._guess.stray_W.value:.4g} W absorbed"
        return f"Explorer('{self.path}', {len(self.controls)} controls{stray})"

    # -- what takes time ---------------------------------------------------------------------------------------------

    def work(self, seconds: float = 0.5) -> bool:
        """
        Do the most urgent job, or wait for one; an error of the job is shown on the page.

        Parameters
        ----------
        seconds : float
            Longest time to wait, s.

        Returns
        -------
        bool
            Whether there was a job, even if it has failed.
        """
        with self._changed:
            job = self._job()
            if job is None:
                self._changed.wait(min(seconds, QUIET_S / 3 if self._stale() else seconds))
                return False
            state = dict(self.state)
        try:
            job(state)
        except (MistrayError, RuntimeError, MemoryError) as error:  # the page goes on, whatever a state brings about
            with self._changed:
                self._tried.add(_key(state))
                self.message = " ".join(str(error).split()) or type(error).__name__
                self._note()
        return True

    def settle(self) -> dict[str, Any]:
        """Trace the present state, unless the last trace is of it, and return the view; no grid and no derivatives."""
        while self._stale():
            self._trace_now(dict(self.state))
        return self.view()

    def prepare(self) -> None:
        """Do all pending background jobs in the calling thread, until none is left."""
        while True:
            with self._changed:
                job, state = self._job(quiet=False), dict(self.state)
            if job is None:
                return
            job(state)

    @property
    def idle(self) -> bool:
        """True if the present state is traced, or could not be, and no background job is left."""
        with self._changed:
            return self._job(quiet=False) is None and not self._busy

    def _stale(self) -> bool:
        """True unless the last trace is of the present state, or a trace of that state has failed."""
        return (self._traced is None or self._traced.state != self.state) and _key(self.state) not in self._tried

    def _job(self, quiet: bool = True) -> Callable[[dict[str, VALUES]], None] | None:
        waited = time.monotonic() - self._moved_at if quiet else math.inf
        if self._stale():
            return self._trace_now if waited >= QUIET_S else None
        if waited < LATER_S:
            return None
        if self._uncompiled:
            return self._compile_ahead
        if self._first_order() and self._slopes_missing():
            return self._find_slopes
        return self._trace_ahead if self._fields_missing() else None

    def _trace_now(self, state: dict[str, VALUES]) -> None:
        with self._doing("tracing"):
            found = self._trace(state)
            with self._changed:
                before = self._traced
                if before is not None:
                    # Coatings change a relative derivative little
                    alike = _of_rays(before, self.controls) == _of_rays(found, self.controls)
                    found.slopes = dict(before.slopes) if alike else {}
                    self._difference = self._compared(before, found)
                self._traced = found
                self._traces += 1
                # Estimates between fields have no derivatives: fields traced with other shapes are traced again
                shapes = _shapes(found, self.controls)
                self._grid = {field: one for field, one in self._grid.items() if _shapes(one, self.controls) == shapes}
                if found.state.get("field") in self.fields:
                    self._grid[float(found.state["field"])] = found
                self._estimate()

    def _compared(self, before: Traced, found: Traced) -> dict[str, Any] | None:
        """
        Return estimated and traced stray power of a traced state, W, and estimate over trace less 1, percent.

        The estimate is from the trace `before`. The result is None if the state has no stray light.
        """
        made = self._guessed(before, found.state)
        stray = found.stray_W
        if not stray.value > 0:
            return None
        return {
            "estimate_W": made.stray_W.value,
            "traced_W": stray.value,
            "traced_se_W": stray.se,
            "percent": 100 * (made.stray_W.value / stray.value - 1),
        }

    def _compile_ahead(self, state: dict[str, VALUES]) -> None:
        """Compile the kernels for bare and for layered surfaces before they are needed, by traces of 64 rays."""
        coatings = self._uncompiled.pop()
        with self._ahead("compiling"):
            self._trace({**state, **coatings}, COMPILING_RAYS)

    def _trace_ahead(self, state: dict[str, VALUES]) -> None:
        """Trace the missing field angle of the grid that is nearest to the present one."""
        field = min(self._fields_missing(), key=lambda value: abs(value - float(state["field"])))
        with self._ahead(f"tracing {field:g}° ahead", field):
            found = self._trace({**state, "field": field})
            with self._changed:
                self._grid[field] = found

    def _find_slopes(self, state: dict[str, VALUES]) -> None:
        """
        Compute derivatives of the stray power with respect to the controls that estimates follow to first order.

        They are relative to the power, per unit of each control. The present estimate is renewed with them.
        """
        assert self._traced is not None
        turned, field = self._first_order(), self._field(state)
        with self._ahead("derivatives"):
            scene = self._loaded(state)
            light = {**self._spectrum(state), **({} if field is None else {"field_deg": (field,)})}
            metric = path_power(scene, "stray", **light, **self._settings, rays=min(self._rays, GRADIENT_RAYS))
            found = gradient(metric, mi.traverse(scene), [key for one in turned for key in one.keys])
            with self._changed:
                over = found.value if found.value > 0 else np.inf
                self._traced.slopes = {
                    one.name: Estimate(
                        float(sum(found.gradient[key][0] for key in one.keys)) / over,
                        float(np.sqrt(found.covariance(one.keys).sum())) / over,
                    )
                    for one in turned
                }
                self._estimate()

    @contextlib.contextmanager
    def _ahead(self, shown: str, what: Any = None) -> Iterator[None]:
        """
        Run a background job in a `with` block, while the view shows the text `shown`.

        An error is reported, and the job, known as `what` or else by the text, is not tried again.
        """
        with self._doing(shown):
            try:
                yield
            except (MistrayError, RuntimeError) as error:
                with self._changed:
                    self._impossible.add(shown if what is None else what)
                    self.message = " ".join(str(error).split())

    @contextlib.contextmanager
    def _doing(self, shown: str) -> Iterator[None]:
        """Show a text for the job in a `with` block while it lasts, however it ends."""
        with self._changed:
            self._busy = shown
            self._note()
        try:
            yield
        finally:
            with self._changed:
                self._busy = ""
                self._note()

    # -- traces ------------------------------------------------------------------------------------------------------

    def _trace(self, state: Mapping[str, VALUES], rays: int | None = None) -> Traced:
        scene = self._loaded(state)
        found = traced(self._traced_rays(scene, state, rays or self._rays), state)
        known = self._looks.of(state)
        for number, group in enumerate(found.sample.groups):  # now, and not when somebody waits for it
            found.factors[number] = self._looks.factor(group.surface, known[group.surface], group.hits)
        return found

    def _traced_rays(self, scene: Any, state: Mapping[str, VALUES], rays: int) -> Trace:
        field = self._field(state) if "field" in self.controls or self.fields else None
        light = {**self._spectrum(state), **self._settings, "polarization": self._polarization}
        with quiet():
            return trace(scene, rays=rays, field_deg=field, **light)

    def _chosen_rays(self) -> int:
        """Return the number of start rays that a trace finishes in about 0.8 s, clipped to 1000 … 20 000."""
        for _ in range(2):  # the first one waits for the compiler
            began = time.monotonic()
            self._traced_rays(self._loaded(self.state), self.state, PILOT_RAYS)
            took = time.monotonic() - began
        return int(min(max(FEWEST_RAYS, round(PILOT_RAYS * TRACE_S / took, -3)), MOST_RAYS))

    def _field(self, state: Mapping[str, VALUES]) -> float | None:
        if "field" in state:
            return float(state["field"])
        return self.fields[0] if self.fields else None

    def _spectrum(self, state: Mapping[str, VALUES]) -> dict[str, Any]:
        return {"wavelength_nm": float(state["wavelength"])} if "wavelength" in state else {}

    def _fields(self, given: Sequence[float] | None) -> list[float]:
        """
        Return the field angles to trace, degrees: those given, else the scene's own and `FIELD_DEG`.

        The list is empty if none are given and the scene's light has no field, or several.

        Raises
        ------
        MistrayError
            If the light cannot have a field angle that is given.
        """
        emitters = [emitter for emitter in self._scene.emitters() if hasattr(emitter, "field_deg")]
        own = [float(emitter.field_deg) for emitter in emitters]
        wanted = list(dict.fromkeys(given if given is not None else [*own[:1], *FIELD_DEG]))
        if given is None and len(own) != 1:
            return []
        for angle in wanted if given is not None else wanted[1:2]:
            try:
                scene_sources(self._scene, angle, None, None)
            except MistrayError:
                if given is not None:
                    raise
                return []
        return wanted

    def _loaded(self, state: Mapping[str, VALUES]) -> Any:
        """Return the scene with coatings and parameters set to a state of the controls."""
        coatings = coatings_of(self.controls, state)
        key = tuple(sorted(coatings.items()))
        if key not in self._scenes:
            scene = self._scene_with(coatings)
            params = mi.traverse(scene)
            layers = {k: np.array(peek(params, k), dtype=np.float64) for k in params.keys()  # noqa: SIM118
                      if k.endswith("thickness_nm")}  # fmt: skip
            self._scenes[key] = scene, layers
            while len(self._scenes) > SCENES_KEPT:
                self._scenes.popitem(last=False)
        self._scenes.move_to_end(key)
        scene, layers = self._scenes[key]
        params = without_scene_update(mi.traverse(scene))
        values = {
            key: np.array([float(state[name])])
            for name, one in self.controls.items()
            for key in one.keys
            if key in params
        }
        if "layers" in state:
            values |= {name: thickness * float(state["layers"]) / 100 for name, thickness in layers.items()}
        assign(params, values)
        check_overlaps(scene)
        return scene

    def _scene_with(self, coatings: Mapping[str, str]) -> Any:
        if not coatings:
            return load(self.path)
        text, _ = coated_text(self.path, Rules(coatings=coatings), self.path.parent)
        return load_text(self.path, text)

    # -- estimates ---------------------------------------------------------------------------------------------------

    def _first_order(self) -> list[Control]:
        return [one for one in self.controls.values() if one.way == OF_FIRST_ORDER]

    def _slopes_missing(self) -> bool:
        return self._traced is not None and not self._traced.slopes and "derivatives" not in self._impossible

    def _fields_missing(self) -> list[float]:
        """
        Return the field angles of the estimate's grid, degrees, that are neither traced yet nor impossible to trace.

        The list is empty without a field control.
        """
        if "field" not in self.controls:
            return []
        return [field for field in self.fields if field not in self._grid and field not in self._impossible]

    def _estimate(self) -> None:
        self._guess = None if self._traced is None else self._guessed(self._traced, self.state)

    def _guessed(self, of: Traced, state: Mapping[str, VALUES]) -> Guess:
        if state.get("field") == of.state.get("field"):
            return guess(of, self._looks, self.controls, state)
        return at_field({**self._grid, float(of.state["field"]): of}, self._looks, self.controls, state)

    def _note(self) -> None:
        """Count a change of the view, and wake the threads that wait for one; the caller must hold the lock."""
        self.version += 1
        self._changed.notify_all()

    def _view(self) -> dict[str, Any]:
        is_traced = self._traced is not None and self._traced.state == self.state
        return {
            "version": self.version,
            "traces": self._traces,
            "values": dict(self.state),
            "busy": self._busy or ("waiting to trace" if self._stale() else ""),
            "message": self.message,
            "label": "nothing yet" if self._traced is None else "traced" if is_traced else "estimate",
            "difference": self._difference if is_traced else None,
            **({} if self._guess is None else view_data(self._guess)),
            "remedy": None if self._traced is None else remedy_data(self._traced.remedy),
        }


def _kinds_of_coatings(controls: Mapping[str, Control]) -> list[dict[str, VALUES]]:
    """
    Return control states with different kernels, to be compiled ahead: a bare part, a layered part, and both.

    They name coatings alone. There are none without a control of coatings, and no layers where no preset is offered.
    """
    choices = {name: one.choices for name, one in controls.items() if one.kind == COATING}
    layered = next(((name, offered[2]) for name, offered in choices.items() if len(offered) > 2), None)
    found: list[dict[str, VALUES]] = [{name: BARE} for name in list(choices)[:1]]
    if layered is not None:
        part, preset = layered
        both: list[dict[str, VALUES]] = [{name: BARE, part: preset} for name in choices if name != part]
        found = [*both[:1], *found, {part: preset}]
    return found


def _key(state: Mapping[str, VALUES]) -> tuple[Any, ...]:
    return tuple(sorted(state.items()))


def _shapes(of: Traced, controls: Mapping[str, Control]) -> dict[str, VALUES]:
    """Return the control values of a trace that estimates follow to first order: shapes, which move rays."""
    return {name: value for name, value in of.state.items() if controls[name].way == OF_FIRST_ORDER}


def _of_rays(of: Traced, controls: Mapping[str, Control]) -> dict[str, VALUES]:
    """Return the control values that the rays of a trace depend on: `_shapes`, field and wavelength."""
    light = {name: value for name, value in of.state.items() if controls[name].kind in (FIELD, WAVELENGTH)}
    return _shapes(of, controls) | light
