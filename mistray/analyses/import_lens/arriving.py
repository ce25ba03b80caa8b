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
    Share of the beam of an imported scene file that reaches its detector, without reflections at glass.

    Attributes
    ----------
    scene_file : Path
        The scene file.
    share : float
        Share of the beam's flux that the detector absorbs, 0 … 1.
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
        """Return the arriving share and the entrances as JSON-serialisable values."""
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
    """Return the share of a scene's beam that arrives at its detector, and the entrances of light, by tracing both."""
    from mistray.analyses.import_lens.entrances import entrances
    from mistray.scene import load
    from mistray.trace import Settings, trace

    scene = load(scene_file)
    polarization = Settings.of(scene).polarization
    found = trace(scene, rays=RAYS, max_reflections=0, max_scatters=0, ledger=False, polarization=polarization)
    share = found.energy.detected_W / found.pupil_W
    return Arriving(scene_file, share, found.energy.greatest_loss, entrances(scene))
