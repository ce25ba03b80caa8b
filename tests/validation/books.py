"""What no trace of a random system may show: NaN, negative power, open books, lost rays, glass that leaks."""

from typing import Any

import numpy as np

CLOSURE = 1e-4
# Share of the launched flux that may get out of closed glass: hits within the rounding of a rim
LEAK = 1e-5


def faults(t: Any, closed: bool = True) -> list[str]:
    found = []
    e = t.energy
    noisy = ["roulette", "scatter_sampling"]
    if t.settings["max_random_scatters"] < t.settings["max_scatters"]:
        noisy.append("max_scatters")  # what aimed rays alone leave out is a difference
    flux = {
        "detected": e.detected_W,
        "escaped": e.escaped_W,
        **{f"absorbed by {name}": value for name, (value, _) in e.absorbed.items()},
        **{f"absorbed in {name}": value for name, (value, _) in e.absorbed_in.items()},
        **{f"cut by {name}": value for name, value in e.cut.items() if name not in noisy},
        **{f"met by {row.id}": row.incident_W for row in t.surfaces},
        **{f"path {row.path_id}": row.power_W for row in t.paths},
    }
    errors = [se for _, se in (*e.absorbed.values(), *e.absorbed_in.values())]
    spots = [getattr(row, key) for row in t.paths for key in ("error_rays", "x_mm", "y_mm", "rms_radius_mm")]
    free = {
        **{name: e.cut[name] for name in noisy},
        "errors": sum(errors) + e.detected_se_W + e.escaped_se_W,
        "places on the detector": float(np.sum(np.abs(spots))),
        "map": float(np.sum(t.irradiance) + np.nansum(t.irradiance_se)),
    }
    found += [f"{name}: {value}" for name, value in (flux | free).items() if not np.isfinite(value)]
    found += [f"{name}: {value:.3g} W is negative" for name, value in flux.items() if value < 0]
    if t.irradiance.min() < 0:
        found.append(f"the map goes down to {t.irradiance.min():.3g}")
    for row in t.surfaces:
        if row.absorbed_W > row.incident_W * (1 + 1e-6):
            found.append(f"{row.id} absorbs {row.absorbed_W:.9g} of {row.incident_W:.9g} W")
    if not abs(e.closure) <= CLOSURE:
        found.append(f"closure {e.closure:.2g}")
    if closed and e.cut["medium"] > LEAK * e.launched_W:
        found.append(f"{e.cut['medium'] / e.launched_W:.2g} of the light is in a material that is not there")
    pixel = (t.extent[1] - t.extent[0]) * (t.extent[3] - t.extent[2]) / t.irradiance.size
    for name, value in (("paths", sum(row.power_W for row in t.paths)), ("map", float(t.irradiance.sum()) * pixel)):
        if not abs(value - e.detected_W) <= 1e-6 * e.launched_W:
            found.append(f"{name} hold {value:.9g} W of {e.detected_W:.9g} W detected")
    started = sum(run.started.sum() for run in t.runs)
    if started != t.settings["rays"]:
        found.append(f"{started} rays started of {t.settings['rays']}")
    return found
