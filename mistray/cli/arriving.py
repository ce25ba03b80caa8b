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
    lost : str
        What takes most of the rest, see `mistray.trace.energy.Energy.greatest_loss`.
    """

    scene_file: Path
    share: float
    lost: str

    def require(self) -> None:
        """Raise if no light arrives; the file stays where it is."""
        if self.share > 0:
            return
        raise MistrayError(
            f"{self.scene_file} is written, but no light of its source reaches the detector: {self.lost} of it; look "
            f"at it with 'mistray view {shlex.quote(str(self.scene_file))}'"
        )


def arriving(scene_file: Path) -> Arriving:
    """Trace the beam of a scene that was written."""
    from mistray.scene import load
    from mistray.trace import trace

    found = trace(load(scene_file), rays=RAYS, max_reflections=0, max_scatters=0, ledger=False)
    return Arriving(scene_file, found.energy.detected_W / found.pupil_W, found.energy.greatest_loss)
