"""Base class for sensors that record light in passing, wherever they stand."""

from __future__ import annotations

from typing import ClassVar

import mitsuba as mi

from mistray.errors import MistrayError
from mistray.ids import check_id
from mistray.physics.geometry.pose import rigid_motion
from mistray.recorders.passing.cells import PassingLight


class PassingSensor(mi.Sensor):
    """
    A sensor of a scene that every trace gets a recorder from.

    Attributes
    ----------
    what : str
        Name of its kind, for messages.
    placed : bool
        Whether it has a place of its own; else it belongs to surfaces.
    name : str
        Its id, under which a trace has its recorder.
    matrix : (4, 4) float64
        Rigid transform from its frame to the world.
    has_film : bool
        Whether the scene gives it a film.
    """

    what: ClassVar[str] = "sensor"
    placed: ClassVar[bool] = True

    def __init__(self, props: mi.Properties) -> None:
        # Only objects are looked at: what is looked at counts as known, and unknown numbers shall be refused
        objects = [key for key in props.keys() if props.type(key) == mi.Properties.Type.Object]  # noqa: SIM118
        self.has_film = any(isinstance(props[key], mi.Film) for key in objects)
        super().__init__(props)
        self.name = str(props.id()) or self.what
        self.owner = f"{self.what} '{self.name}'"
        check_id(self.name, self.what)
        if not self.placed and "to_world" in props:
            raise MistrayError(f"{self.owner}: it has to_world, but surfaces have their own place; leave it out")
        self.matrix = rigid_motion(props.get("to_world", mi.ScalarTransform4f()).matrix, self.owner)

    def recorder(self) -> PassingLight:
        """A new recorder that has recorded nothing."""
        raise NotImplementedError

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """No parameter of it has a derivative."""

    def to_string(self) -> str:
        return f"{type(self).__name__}[{self.name}]"
