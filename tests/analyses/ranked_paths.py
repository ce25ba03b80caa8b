"""Three ghosts whose order differs by power, by RMS irradiance and by the brightest pixel."""

from __future__ import annotations

from functools import cache

from analyses.fake_scene import lens_scene
from analyses.fake_trace import LENS, FakePath, FakeTrace

from mistray.analyses.ghosts.result import GhostReport

# Discs of even irradiance: P/(π a²) is the peak and 2P/(π a²) the RMS irradiance, as r_rms² = a²/2
# 1 mW: peak 0.00063, RMS irradiance 0.0013
WIDE = f"{LENS} detector:R L1_rear:T L1_front:T window_rear:R L1_front:T L1_rear:T detector:A"
ROUND = f"{LENS} detector:R L1_rear:R detector:A"  # 0.2 mW: peak 0.0016, RMS irradiance 0.0032
# Two discs of 0.1 mW at x = ±1 mm, r_rms = 1 mm: peak 0.0032, RMS irradiance 0.00006
TWIN = f"{LENS} detector:R L1_rear:T L1_front:R L1_rear:T detector:A"
ORDERS = {"rms": (ROUND, WIDE, TWIN), "power": (WIDE, ROUND, TWIN), "peak": (TWIN, ROUND, WIDE)}
LINES = {450.0: 0.5, 650.0: 0.5}


@cache
def _traced() -> FakeTrace:
    paths = []
    for sign, line in zip((-1, 1), LINES, strict=True):
        paths += [
            FakePath(WIDE, 5e-4, 100_000, 0.0, 0.0, 0.7071, line),
            FakePath(ROUND, 1e-4, 20_000, 0.0, 0.0, 0.2, line),
            FakePath(TWIN, 1e-4, 20_000, float(sign), 0.0, 0.1, line),
            FakePath(f"{LENS} detector:A", 1.0, 1000, 0.0, 0.0, 0.02, line),
        ]
    return FakeTrace(paths, shares=LINES)


def ranked_report(rank: str = "rms") -> GhostReport:
    """One field with the three ghosts at two wavelengths; the halves of the twin are of one wavelength each."""
    trace = _traced()
    return GhostReport(lens_scene(), {0.0: trace}, trace, {}, rank)
