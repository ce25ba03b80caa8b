"""Materials of a lens: names with the indices of another program's media, and k = 0 where k is unknown."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mistray.errors import MistrayError
from mistray.materials import complex_index, refractive_index

_SAME_INDEX = 2e-6
_ROUND_OFF = 1e-12


def same_material(names: Sequence[str], index_at: Callable[[float], float], wavelengths_nm: Sequence[float]) -> str:
    """
    Return a material string with the refractive indices of another program's medium.

    Parameters
    ----------
    names : sequence of str
        Candidate names, the likeliest first; a name is accepted if its n agrees within 2e-6 at all wavelengths.
    index_at : callable
        Function from wavelength in nm to n of the medium.
    wavelengths_nm : sequence of float
        Wavelengths of the lens, nm.

    Returns
    -------
    str
        "air" if n is 1; a name, else a constant index or a table of n at these wavelengths; `` k=0`` is appended if k
        is unknown.
    """
    indices = [float(index_at(wavelength)) for wavelength in wavelengths_nm]
    if all(abs(n - 1) < _ROUND_OFF for n in indices):
        return "air"
    for name in names:
        try:
            if all(
                abs(refractive_index(name, wavelength) - n) < _SAME_INDEX
                for wavelength, n in zip(wavelengths_nm, indices, strict=True)
            ):
                return with_k(name, wavelengths_nm)
        except MistrayError:
            continue
    if len(set(indices)) == 1:
        return f"{indices[0]!r} k=0"
    points = sorted(set(zip((float(w) for w in wavelengths_nm), indices, strict=True)))
    return " ".join(f"n({wavelength!r})={n!r}" for wavelength, n in points) + " k=0"


def with_k(material: str, wavelengths_nm: Sequence[float]) -> str:
    """Return a material string, with `` k=0`` appended if its absorption is unknown at one of the wavelengths, nm."""
    try:
        for wavelength in wavelengths_nm:
            complex_index(material, wavelength)
    except MistrayError:
        return f"{material} k=0"
    return material


def usable(material: str, wavelengths_nm: Sequence[float]) -> str:
    """Return a material string as `with_k` does; raise `MistrayError` if n is unknown at one of the wavelengths, nm."""
    for wavelength in wavelengths_nm:
        refractive_index(material, wavelength)
    return with_k(material, wavelengths_nm)
