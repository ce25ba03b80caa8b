"""Whether the light of an imported scene still reaches its detector."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

from mistray.errors import MistrayError

RAYS = 4000


@dataclass(frozen=True)
class Arriving:
    """
    What happens to the beam of a scene's source, at its own field, with no reflection at glass.

    Attributes
    ----------
    share : float
        What the detector absorbs of it.
    taker : str
        The surface that takes most of it, and `taken`, its share.
    escaped : float
        What leaves the scene of it.
    """

    scene_file: Path
    share: float
    taker: str
    taken: float
    escaped: float

    def require(self) -> None:
        """Raise if no light arrives; the file stays where it is."""
        if self.share > 0:
            return
        lost = f"'{self.taker}' takes" if self.taken > self.escaped else "the outside gets"
        raise MistrayError(
            f"{self.scene_file} is written, but no light of its source reaches the detector: {lost} "
            f"{100 * max(self.taken, self.escaped):.3g} % of it; look at it with "
            f"'mistray view {shlex.quote(str(self.scene_file))}'"
        )


def arriving(scene_file: Path) -> Arriving:
    """Trace the beam of a scene that was written."""
    from mistray.scene import load
    from mistray.trace import trace

    energy = trace(load(scene_file), rays=RAYS, max_reflections=0, max_scatters=0, ledger=False).energy
    name, (taken_W, _) = max(energy.absorbed.items(), key=lambda item: item[1][0], default=("", (0.0, 0.0)))
    unit = energy.launched_W
    return Arriving(scene_file, energy.detected_W / unit, name, taken_W / unit, energy.escaped_W / unit)
