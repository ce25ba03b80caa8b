"""Scatter models on surfaces of a prescription."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

from mistray.errors import MistrayError, nearest
from mistray.prescription.coating import check_name
from mistray.ranges import ANYTHING, ByName, OfType, Several
from mistray.scatter.kinds import KINDS
from mistray.scatter.lobe import Placement

Value = bool | int | float | str


PROPERTIES = ByName(ANYTHING, "{'rms_nm': 4.0}")
LAID = ("sample_axis", "rotation_deg")  # how a sample lies on its surface, of `tabulated`


@dataclass(frozen=True)
class Scatter:
    """
    A scatter plugin that is nested in the interface of a surface; see docs/scatter.md.

    Attributes
    ----------
    kind : str
        Name of the plugin, one of `mistray.scatter.kinds.KINDS`.
    properties : mapping of str to bool, number or str
        Properties of the plugin as in XML, for example ``{"rms_nm": 4.0}``. Files are relative to the scene file.
    name : str or None
        Surfaces whose scatter has the same name share one object in the scene, with one set of parameters; ``None``:
        each surface has its own.

    Raises
    ------
    MistrayError
        If the plugin or a property is unknown, or the model refuses a value.

    Examples
    --------
    >>> polish = mistray.Scatter("harvey_shack", {"rms_nm": 2.0, "l": 0.01, "s": -1.5})
    >>> polish.model().rms_nm
    2.0
    >>> mirror = mistray.Surface("primary", radius=-1000, semi_diameter=100, mirror=True, scatter=(polish,))
    """

    kind: str
    properties: Mapping[str, Value] = field(default_factory=dict)
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise MistrayError(f"scatter '{self.kind}': there is no such model; use {', '.join(KINDS)}")
        if self.name is not None:
            check_name(self.name)
        for key, value in PROPERTIES.check("properties", self.properties, f"scatter '{self.kind}'").items():
            if not isinstance(value, Value):
                raise MistrayError(f"scatter '{self.kind}': {key} = {value!r}; give a number, a text or a boolean")
        self.model()

    def __hash__(self) -> int:
        return hash((self.kind, tuple(sorted(self.properties.items())), self.name))

    def model(self) -> Placement | None:
        """
        Return the scatter model for computation; None if it needs a file, which only the scene can locate.

        Raise `MistrayError` if a property is unknown or out of range.
        """
        title, model = f"scatter '{self.kind}'", KINDS[self.kind]
        laid = LAID if self.kind == "tabulated" else ()
        given: dict[str, Any] = {key: value for key, value in self.properties.items() if key not in laid}
        for key, value in given.items():
            param = model.param(key)
            if param is None:
                raise MistrayError(f"{title}: there is no '{key}'; {nearest(key, model.params())}")
            param.check(key, value, title)
        # A file stands beside a scene that may not exist yet: its reader checks it
        return None if "file" in given else model.of(**given)

    def moved(self, seen: Callable[[str], str]) -> Scatter:
        """Return the same scatter with the path of its file, if any, changed by the function `seen`."""
        file = self.properties.get("file")
        return self if file is None else replace(self, properties={**self.properties, "file": seen(str(file))})


SCATTER = Several(OfType(Scatter, "must be a mistray.Scatter, or several"), least=0)
"""Condition on the scatter models of a surface."""
