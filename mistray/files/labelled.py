"""Results as arrays with named axes, for xarray and, through it, NetCDF and Zarr.

Each array and each coordinate has the attributes ``long_name`` and ``units``, with units as in the CF conventions ("W
mm-2", "mm", "degree", "1"). An array with a standard error names it in ``ancillary_variables``. The attribute ``facts``
of the dataset describes its origin and its computation, as JSON. Source: CF Metadata Conventions 1.11, sections 3.1 to
3.4.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from mistray.files.json_values import plain
from mistray.files.packages import package

if TYPE_CHECKING:
    import xarray

IRRADIANCE = "W mm-2"


@dataclass(frozen=True)
class Labelled:
    """
    Array with named axes and a unit.

    Attributes
    ----------
    axes : tuple of str
        Names of the axes.
    values : array
        Numbers or texts, with one dimension per axis.
    units : str
        Unit of the values; "1" for pure numbers, "" for text.
    long_name : str
        Description of the quantity.
    standard_error : array or None
        Standard error of each value; stored under the name of the array with ``_se``.
    """

    axes: tuple[str, ...]
    values: npt.ArrayLike
    units: str
    long_name: str
    standard_error: npt.ArrayLike | None = None

    def attributes(self, **more: str) -> dict[str, str]:
        """Return long name, unit and `more` attributes of the array, for xarray."""
        return {"long_name": self.long_name, **({"units": self.units} if self.units else {}), **more}


def dataset(
    arrays: Mapping[str, Labelled], coordinates: Mapping[str, Labelled], title: str, facts: Mapping[str, Any]
) -> xarray.Dataset:
    """
    Return an `xarray.Dataset` of arrays that share axes; standard errors are arrays of their own, ``NAME_se``.

    Parameters
    ----------
    arrays, coordinates : mapping of str to Labelled
        Arrays and coordinates, keyed by name.
    title : str
        Title of the dataset.
    facts : mapping of str to JSON-serialisable values
        Origin and settings of the result.

    Raises
    ------
    MistrayError
        If xarray is not installed.
    """
    made: dict[str, Any] = {}
    for name, array in arrays.items():
        error = f"{name}_se"
        more = {} if array.standard_error is None else {"ancillary_variables": error}
        made[name] = (array.axes, np.asarray(array.values), array.attributes(**more))
        if array.standard_error is not None:
            words = array.attributes() | {"long_name": f"standard error of {array.long_name}"}
            made[error] = (array.axes, np.asarray(array.standard_error), words)
    places = {name: (c.axes, np.asarray(c.values), c.attributes()) for name, c in coordinates.items()}
    whole = {"title": title, "Conventions": "CF-1.11", "facts": json.dumps(plain(dict(facts)), allow_nan=False)}
    found: xarray.Dataset = package("to_xarray needs xarray", "xarray", "xarray").Dataset(made, places, whole)
    return found


def pixel_coordinates(extent_mm: tuple[float, float, float, float], shape: tuple[int, int]) -> dict[str, Labelled]:
    """Return coordinates x and y of pixel centres, mm, by name, from edges x0, x1, y0, y1, mm, and (rows, columns)."""
    x0, x1, y0, y1 = extent_mm
    rows, columns = shape

    def middles(low: float, high: float, count: int) -> np.ndarray:
        return low + (np.arange(count) + 0.5) * (high - low) / count

    return {
        "y": Labelled(("y",), middles(y0, y1, rows), "mm", "y in the frame of the detector"),
        "x": Labelled(("x",), middles(x0, x1, columns), "mm", "x in the frame of the detector"),
    }


def irradiance_dataset(trace: Any) -> xarray.Dataset:
    """Return the irradiance of a `mistray.Trace`, W/mm², as a dataset, see `mistray.trace.Trace.to_xarray`."""
    axes, each = ("wavelength", "y", "x"), [trace.irradiance_at(nm) for nm in trace.wavelengths_nm]
    values, errors = (np.stack(parts) for parts in zip(*each, strict=True))
    arrays = {
        "irradiance": Labelled(axes[1:], trace.irradiance, IRRADIANCE, "irradiance", trace.irradiance_se),
        "irradiance_by_wavelength": Labelled(axes, values, IRRADIANCE, "irradiance of a wavelength", errors),
    }
    wavelengths = Labelled(("wavelength",), trace.wavelengths_nm, "nm", "wavelength in vacuum")
    rows, columns = trace.irradiance.shape
    coordinates = {"wavelength": wavelengths, **pixel_coordinates(trace.extent, (rows, columns))}
    return dataset(arrays, coordinates, "Irradiance of a detector", trace.settings)
