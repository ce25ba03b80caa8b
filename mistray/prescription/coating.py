"""Coatings of the surfaces in a prescription."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace

from mistray.coatings import preset, read_coating
from mistray.coatings.simple import check_shares
from mistray.coatings.stack import SIDES, moved_layers
from mistray.errors import MistrayError
from mistray.ids import check_written_id
from mistray.ranges import FLAG, INDEX_SHIFT, WAVELENGTH_NM, ByName, Each, OfType, Words, check_fields

INDEX_SHIFTS = Each(INDEX_SHIFT, least=0)  # of the layers


@dataclass(frozen=True)
class Coating:
    """
    Coating of an interface; an interface without one is bare Fresnel.

    Exactly one of ``R``, ``table``, ``layers`` and ``preset`` defines the coating; see the plugin `thinfilm` and
    docs/coatings.md.

    Attributes
    ----------
    R : float or None
        Reflected fraction of the incident flux in [0, 1], from both sides and at every angle.
    T : float or None
        Transmitted fraction, likewise; R + T ≤ 1, the rest is absorbed. ``None`` with R given: opaque.
    table : str or None
        CSV file over wavelength and angle, or ``COATING.DAT:NAME`` for a coating of a Zemax file, relative to the scene
        file.
    layers : str or None
        Layers such as ``"MgF2 99.64, 2.1 0.5w"``: material and thickness in nm, or in waves of `design_nm`.
    preset : str or None
        Name of a preset of `mistray.coatings.presets`.
    first : str
        Place of the first layer: "outside" (the side of lower index), "front" or "back".
    design_nm : float
        Wavelength that thicknesses in waves refer to, nm.
    n_shift, k_shift : tuple of float
        Shifts added to n and k of each layer; empty means zeros.
    mirror : bool
        Whether layers are those of a mirror: nothing gets through, and the last layer of a Zemax coating is the
        substrate.
    name : str or None
        Surfaces whose coatings have the same name share one object in the scene, with one set of parameters; ``None``:
        each surface has its own.

    Raises
    ------
    MistrayError
        If not exactly one recipe is given, a value is out of range, or an option does not go with the recipe.

    Examples
    --------
    >>> antireflection = mistray.Coating(layers="MgF2 0.25w", design_nm=550)
    >>> mirror = mistray.Coating(R=0.98)
    >>> mirror.opaque, antireflection.opaque
    (True, False)
    """

    R: float | None = None
    T: float | None = None
    table: str | None = None
    layers: str | None = None
    preset: str | None = None
    _: KW_ONLY
    first: str = Words(SIDES).field("outside")
    design_nm: float = WAVELENGTH_NM.field(550.0)
    n_shift: tuple[float, ...] = INDEX_SHIFTS.field(())
    k_shift: tuple[float, ...] = INDEX_SHIFTS.field(())
    mirror: bool = FLAG.field(False)
    name: str | None = None

    def __post_init__(self) -> None:
        what = f"coating '{self.name}'" if self.name else "coating"
        recipes = {"R": self.R, "table": self.table, "layers": self.layers, "preset": self.preset}
        given = [key for key, value in recipes.items() if value is not None]
        if len(given) != 1:
            raise MistrayError(
                f"{what}: it has {' and '.join(f'{key} = {recipes[key]!r}' for key in given) or 'no recipe'}; "
                "give one of R (and T), table, layers and preset"
            )
        if self.R is not None:
            check_shares(self.R, self.T or 0.0, what)
        elif self.T is not None:
            raise MistrayError(f"{what}: T = {self.T} beside {given[0]} = {recipes[given[0]]!r}, which already holds T")
        if self.preset is not None:
            preset(self.preset, self.design_nm)
        if self.name is not None:
            check_name(self.name)
        check_fields(self, what)
        defaults = Coating.__dataclass_fields__
        for key in ("first", "design_nm", "n_shift", "k_shift", "mirror"):
            if getattr(self, key) != defaults[key].default and not self.layered:
                raise MistrayError(f"{what}: {key} has no meaning beside {given[0]}, which has no layers; remove it")

    @property
    def layered(self) -> bool:
        """True if the scene needs the `thinfilm` plugin: for layers, a preset, or a Zemax coating, of layers or not."""
        zemax = self.table is not None and not self.table.lower().endswith(".csv")
        return self.layers is not None or self.preset is not None or zemax

    @property
    def opaque(self) -> bool:
        """True if the coating transmits no light: of a `mirror`, R without T, or an opaque preset; else False."""
        if self.mirror:
            return True
        if self.preset is not None:
            return preset(self.preset).opaque
        return self.R is not None and not self.T

    def blocks(self, seen: Callable[[str], str] = str) -> bool:
        """True if the coating transmits no light, as `opaque` says or its table, whose path to open `seen` returns."""
        if self.table is None or self.mirror:
            return self.opaque
        return read_coating(self.table, self.design_nm, resolve=seen).opaque

    def moved(self, seen: Callable[[str], str]) -> Coating:
        """Return the coating with its file paths, those of a table or of layers, changed by the function `seen`."""
        if self.table is not None:
            return replace(self, table=seen(self.table))
        return self if self.layers is None else replace(self, layers=moved_layers(self.layers, seen))


BLACK = Coating(R=0.0)
"""Coating that absorbs all light."""


def check_name(name: str) -> None:
    """Raise `MistrayError` if a string cannot be the id of a shape, coating or scatter model."""
    if not name or "." in name:
        raise MistrayError(f"shape '{name}': a name must not be empty or hold a dot")
    check_written_id(name, "shape")


COATINGS = ByName(OfType(Coating | None, "must be a mistray.Coating or None"), "{'AR': mistray.Coating(R=0.01)}")
"""Condition on coatings by the names of faces or of the coatings in a file."""
