"""Mitsuba's own BSDFs in scenes: translation into interfaces, and remedies for those that have none."""

from mistray.scene.mitsuba_bsdfs.remedies import remedy
from mistray.scene.mitsuba_bsdfs.translation import translate_bsdfs

__all__ = ["remedy", "translate_bsdfs"]


def __dir__() -> list[str]:
    return sorted(__all__)
