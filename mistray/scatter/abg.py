"""ABg model of the scatter of a surface, as in TracePro, OpticStudio and FRED."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from mistray.errors import MistrayError
from mistray.param import Param
from mistray.physics import abg
from mistray.ranges import NOT_NEGATIVE, SLOPE, TEXT
from mistray.scatter.lobe import Lobe, Placement
from mistray.scatter.numbers import REFERENCE, unusual, within

SMALLEST_B = 1e-12


@dataclass(frozen=True)
class ABg(Placement):
    """
    ABg scatter, BSDF = A/(B + |β - β0|^g), the same in reflection and transmission and from both sides.

    β is taken in the medium of the scattered light. Equations and sources: `mistray.physics.abg`.

    Attributes
    ----------
    A : float
        Numerator of the BSDF, 1/sr, ≥ 0; 0 scatters nothing.
    B : float
        Constant of the denominator, > 1e-12; ≥ 0 if g = 0. The specular BSDF is A/B.
    g : float
        Slope, ≥ 0; 0 gives a Lambertian surface of reflectance π A/(1 + B).
    reference_nm : float, optional
        Vacuum wavelength, nm, at which A and B hold. At another wavelength the same smooth surface has A k^(g-4) and B
        k^g, with k = λ/reference_nm. Without it the model is independent of the wavelength, as in TracePro, OpticStudio
        and FRED.

    Raises
    ------
    MistrayError
        If a parameter is out of range.
    """

    A: float = Param("1/sr", NOT_NEGATIVE, "amplitude").field()
    B: float = Param("1", NOT_NEGATIVE, "(r of the knee)^g, > 1e-12; may be 0 if g = 0").field()
    g: float = Param("1", SLOPE, "slope; 0: Lambertian, reflectance π A/(1 + B)", tolerance=0.05).field()
    reference_nm: float | None = REFERENCE.field(None)

    also = MappingProxyType(
        {
            "file": Param(
                "file",
                TEXT,
                "entry of an OpticStudio catalogue, ``ABG_DATA.DAT:NAME``, instead of A, B, g and ``reference_nm``",
                default=None,
            )
        }
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.g > 0 and self.B <= SMALLEST_B:
            raise MistrayError(f"{self.title}: B is {self.B:g}; give B > {SMALLEST_B:g}, or B ≥ 0 with g = 0")

    @classmethod
    def of(cls, resolve: Callable[[str], str] = str, **properties: Any) -> ABg:
        """
        Return the model with given properties, see `Placement.of`.

        `file` names the entry of a catalogue to use; A, B, g and `reference_nm` must then be left out.
        """
        if "file" not in properties:
            return super().of(**properties)
        given = [key for key in ("A", "B", "g", "reference_nm") if key in properties]
        if given:
            raise MistrayError(f"{cls.__name__}: file and {given[0]} given; give the name in the file or the numbers")
        from mistray.scatter.measured.zemax_abg import abg_from_catalogue  # which makes an ABg

        path, colon, name = properties.pop("file").rpartition(":")
        return abg_from_catalogue(f"{resolve(path)}{colon}{name}", **properties)

    def event_lobes(self, event: str, wavelength_nm: float, n_in: float, n_out: float) -> tuple[Lobe, ...]:
        """Return the lobe of an event, or () if A is 0, see `Placement.event_lobes`."""
        if self.A == 0:
            return ()
        a, b = self.A, self.B
        if self.reference_nm is not None:
            a, b = abg.at_wavelength(a, b, self.g, wavelength_nm / self.reference_nm)
        # Without a slope there is no peak to sample: a Lambertian is flat over all directions
        centre = "normal" if self.g == 0 else "specular"
        return (Lobe(event, lambda r: abg.bsdf(r, a, b, self.g), centre=centre, shares=self.shares),)

    def advice(self) -> str | None:
        """
        Return a line of advice if B, g or the total scatter are unusual; None otherwise, and if A or g is 0.

        Surfaces of optics have g of 1.5 … 3.5, mostly 2 … 3, and B of 1e-10 … 1e-6. Paints have B of 0.1 … 1 and g of 2
        … 6. g = 0 is Lambertian (webinar on stray light with TracePro, "Typical BSDF"). Parameters fitted to a polished
        mirror may have a larger B, so this is advice and not an error.
        """
        if self.A == 0 or self.g == 0:
            return None
        optic = within(self.g, 1.5, 3.5) and within(self.B, 1e-10, 1e-6)
        paint = within(self.g, 2, 6) and within(self.B, 0.1, 1)
        text = (
            f"B {self.B:g} and g {self.g:g} are outside what is usual: B 1e-10 … 1e-6, g 1.5 … 3.5 for optics, "
            "B 0.1 … 1, g 2 … 6 for paints, Lambertian g 0"
        )
        return unusual(self.title, None if optic or paint else text, total=abg.tis(self.A, self.B, self.g))
