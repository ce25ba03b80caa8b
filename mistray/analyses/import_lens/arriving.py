"""Check that the light of an imported scene still reaches its detector."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError

if TYPE_CHECKING:
    from mistray.analyses.import_lens.entrances import Entrances

RAYS = 4000


@dataclass(frozen=True)
class Arriving:
    """
    Fraction of the light of an imported scene that reaches its detector without reflections at glass.

    Attributes
    ----------
    scene_file : Path
        Scene file.
    share : float
        Flux that the detector absorbs over that through the source's ``pupil_area``, or over all its flux without one;
        above 1 if light beside that area arrives.
    lost : str
        Largest loss of the rest, see `mistray.trace.energy.Energy.greatest_loss`.
    entrances : Entrances
        Surfaces through which the detector sees the side of the source.
    """

    scene_file: Path
    share: float
    lost: str
    entrances: Entrances

    def record(self) -> dict[str, Any]:
        """Return the arriving fraction of the light and the entrances as JSON-serialisable values."""
        others = [{"surface": name, "share": share} for name, share in self.entrances.others.items()]
        return {"arriving_share": self.share, "entrances": {**asdict(self.entrances), "others": others}}

    def require(self) -> None:
        """Raise `MistrayError` if no light arrives; the scene file is kept."""
        if self.share > 0:
            return
        raise MistrayError(
            f"{self.scene_file} is written, but no light of its source reaches the detector: {self.lost} of it; look "
            f"at it with 'mistray view {shlex.quote(str(self.scene_file))}'"
        )


def arriving(scene_file: Path) -> Arriving:
    """Return the fraction of a scene's light that arrives at its detector, and the entrances of light, from traces."""
    from mistray.analyses.import_lens.entrances import entrances
    from mistray.scene import load
    from mistray.trace import Settings, trace

    scene = load(scene_file)
    polarization = Settings.of(scene).polarization
    found = trace(scene, rays=RAYS, max_reflections=0, max_scatters=0, ledger=False, polarization=polarization)
    share = found.energy.detected_W / found.pupil_W
    return Arriving(scene_file, share, found.energy.greatest_loss, entrances(scene))
