"""Entry of the catalogue: the pages or numbers that the name of a material stands for."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Entry:
    """
    Catalogue entry of a material: the pages, or stated numbers, from which its n and k come.

    Attributes
    ----------
    name : str
        Name in the spelling of the catalogue; glasses have their maker in front, as in ``schott/N-BK7``.
    page : str
        Page with n, and with k if `k_page` is None; literature reference if `nd_vd` gives n.
    k_page : str or None
        Page with k, if it is another one.
    nd_vd : (float, float) or None
        nd and Vd of a material without a page. Its k is unknown.
    to_nm : float or None
        Longest wavelength for which the page is used, nm; None for the end of its data.
    k_stated : tuple of (float, float)
        Wavelengths, nm, and values of k if no page has k; linear between them, constant beyond them.
    k_reference : str
        Source of `k_stated`.
    beyond : Entry or None
        Entry that is used for wavelengths that this page does not cover.
    """

    name: str
    page: str
    k_page: str | None = None
    nd_vd: tuple[float, float] | None = None
    to_nm: float | None = None
    k_stated: tuple[tuple[float, float], ...] = ()
    k_reference: str = ""
    beyond: Entry | None = None

    @property
    def chain(self) -> tuple[Entry, ...]:
        """Entry itself, then the entries that replace it at wavelengths beyond its range, in this order."""
        return (self, *(self.beyond.chain if self.beyond is not None else ()))


def by_wavelength(*entries: Entry) -> Entry:
    """Return one entry made of several: at each wavelength the first whose page covers it is used."""
    first, *others = entries
    if not others:
        return first
    return replace(first, beyond=by_wavelength(*others))
