"""Base class for sensors that record light in passing: at a place of their own, at surfaces, or far away."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.ids import check_id
from mistray.param import OBJECT, Param, fixed
from mistray.physics.geometry.pose import rigid_motion
from mistray.recorders.flux_maps.cells import PassingLight

FRAME = {"to_world": fixed("transform", OBJECT, "its frame", within="rigid", otherwise="identity")}


class PassingSensor(mi.Sensor):
    """
    Base class of sensors of a scene, from which every trace makes a recorder of light in passing.

    Attributes
    ----------
    what : str
        Name of its kind, for error messages.
    properties : mapping of str to Param
        Its parameters by name.
    placed : bool
        Whether it has a position of its own; otherwise it belongs to surfaces.
    filmed : bool
        Whether its cells are the pixels of a film that may be nested in it.
    name : str
        Id of the sensor, or `what` without one, under which a trace has its recorder.
    matrix : (4, 4) float64
        Rigid transform from its frame to the world, mm; the identity if it belongs to surfaces.
    has_film : bool
        Whether the scene nests a film in it.
    """

    what: ClassVar[str] = "sensor"
    properties: ClassVar[Mapping[str, Param]]
    placed: ClassVar[bool] = True
    filmed: ClassVar[bool] = False

    def __init__(self, props: mi.Properties) -> None:
        # Only objects are read here: properties that are read count as known, and unknown numbers must be refused
        objects = [key for key in props.keys() if props.type(key) == mi.Properties.Type.Object]  # noqa: SIM118
        self.has_film = any(isinstance(props[key], mi.Film) for key in objects)
        super().__init__(props)
        self.name = str(props.id()) or self.what
        self.owner = f"{self.what} '{self.name}'"
        check_id(self.name, self.what)
        if self.has_film and not self.filmed:
            raise MistrayError(f"{self.owner}: it has a film, which it does not use; leave the film out")
        if not self.placed and "to_world" in props:
            raise MistrayError(f"{self.owner}: it has to_world, but surfaces have their own place; leave it out")
        self.matrix = rigid_motion(props.get("to_world", mi.ScalarTransform4f()).matrix, self.owner)

    def recorder(self) -> PassingLight:
        """Return a new recorder of the light that the sensor sees, empty so far."""
        raise NotImplementedError

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """Expose no parameters, since none has a derivative."""

    def to_string(self) -> str:
        return f"{type(self).__name__}[{self.name}]"
