"""Base class for sensors that record light in passing, wherever they stand."""

from __future__ import annotations

from typing import ClassVar

import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.ids import check_id
from mistray.recorders.passing.cells import PassingLight


class PassingSensor(mi.Sensor):
    """
    A sensor of a scene that every trace gets a recorder from.

    Attributes
    ----------
    what : str
        Of a message.
    name : str
        Its id, under which a trace has its recorder.
    matrix : (4, 4) float64
        Rigid transform from its frame to the world.
    has_film : bool
        Whether the scene gives it a film.
    """

    what: ClassVar[str] = "sensor"

    def __init__(self, props: mi.Properties) -> None:
        # Only objects are looked at: what is looked at counts as known, and unknown numbers shall be refused
        objects = [key for key in props.keys() if props.type(key) == mi.Properties.Type.Object]  # noqa: SIM118
        self.has_film = any(isinstance(props[key], mi.Film) for key in objects)
        super().__init__(props)
        self.name = str(props.id()) or self.what
        self.owner = f"{self.what} '{self.name}'"
        check_id(self.name, self.what)
        self.matrix = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix, dtype=np.float64).reshape(4, 4)
        rotation = self.matrix[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5) or not np.linalg.det(rotation) > 0:
            raise MistrayError(
                f"{self.owner}: to_world scales, shears or mirrors; use a rigid motion and set the size by parameters"
            )

    def recorder(self) -> PassingLight:
        """A new recorder that has recorded nothing."""
        raise NotImplementedError

    def traverse(self, callback: mi.TraversalCallback) -> None:
        """No parameter of it has a derivative."""

    def to_string(self) -> str:
        return f"{type(self).__name__}[{self.name}]"
