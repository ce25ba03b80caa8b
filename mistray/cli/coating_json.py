"""Output of `mistray coating --json`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mistray.coatings import CoatingModel, CoatingSpectrum

SHARES = ("R", "T", "A")


def as_json(coating: CoatingModel, values: CoatingSpectrum, design_nm: float) -> dict[str, Any]:
    """A coating: its layers, R, T and A over the band, and all of the spectrum, as values that JSON knows."""
    from mistray.files.json_values import plain

    layers, band = layer_rows(coating, design_nm), band_rows(values)
    return dict(plain({"design_nm": design_nm, "layers": layers, "band": band, "spectrum": _spectrum(values)}))


def layer_rows(coating: CoatingModel, design_nm: float) -> list[dict[str, Any]]:
    """The layers of a stack; none of other coatings."""
    from mistray.coatings import Stack

    if not isinstance(coating, Stack):
        return []
    return [
        {"material": layer.material, "thickness_nm": layer.thickness_nm, "n": n.real, "k": n.imag}
        | {"waves": n.real * layer.thickness_nm / design_nm}
        for layer, n in zip(coating.layers, coating.indices(design_nm), strict=True)
    ]


def band_rows(values: CoatingSpectrum) -> list[dict[str, Any]]:
    """For each angle the means over the wavelengths, and where R is least and greatest, of unpolarised light."""
    rows = []
    for k, angle in enumerate(values.angle_deg):
        r = values.mean()[:, k]
        least, greatest = r.argmin(), r.argmax()
        rows.append(
            {
                "angle_deg": angle,
                **{f"{share}_mean": values.mean(share)[:, k].mean() for share in SHARES},
                "R_least": r[least],
                "R_least_at_nm": values.wavelength_nm[least],
                "R_greatest": r[greatest],
                "R_greatest_at_nm": values.wavelength_nm[greatest],
            }
        )
    return rows


def _spectrum(values: CoatingSpectrum) -> list[dict[str, Any]]:
    """A row for each angle and wavelength."""
    return [
        {
            "angle_deg": angle,
            "wavelength_nm": wavelength,
            **{f"{share}_{pol}": getattr(values, share)[i, k, p] for share in SHARES for p, pol in enumerate("sp")},
            "phase_r_rad": values.phase_r[i, k],
            "phase_t_rad": values.phase_t[i, k],
        }
        for k, angle in enumerate(values.angle_deg)
        for i, wavelength in enumerate(values.wavelength_nm)
    ]
