"""Meaning of the name of a material."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Entry:
    """
    Meaning of a name.

    Attributes
    ----------
    name : str
        As the catalogue spells it; glasses have their maker in front, as in ``schott/N-BK7``.
    page : str
        Page of n, and of k where `k_page` is None; literature where `nd_vd` has n.
    k_page : str or None
        Page of k, where another page has it.
    nd_vd : (float, float) or None
        nd and Vd of a material that has no page. Its k is unknown.
    to_nm : float or None
        Longest wavelength that the page is asked for, nm; None where the page ends.
    k_stated : tuple of (float, float)
        k where no page has it: wavelengths in nm and values. Between them k is linear, beyond them that of the end.
    k_reference : str
        Where `k_stated` comes from.
    beyond : Entry or None
        Entry that is asked for wavelengths that this page does not cover.
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
        """The entry and those beyond it, in the order in which they are asked."""
        return (self, *(self.beyond.chain if self.beyond is not None else ()))


def by_wavelength(*entries: Entry) -> Entry:
    """One entry of several: the first whose page covers a wavelength is asked for it."""
    first, *others = entries
    if not others:
        return first
    return Entry(
        first.name, first.page, first.k_page, first.nd_vd, first.to_nm, first.k_stated, first.k_reference,
        by_wavelength(*others),
    )  # fmt: skip
