"""A small stand-in for `mistray.trace.Trace`: rays drawn from known discs, so that every number is known."""

import math
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from analyses.fake_scene import lens_scene
from fake_ledger import GLASS, SENSOR, STRUCTURE, decoded, encode, fake_run, hit_sums

from mistray.analysis import GhostReport
from mistray.recorders.film import Pixels
from mistray.recorders.ledger import SUMS
from mistray.settings import BATCHES
from mistray.trace import Energy, FluxReport, Settings, SurfaceFlux
from mistray.trace.paths import path_table
from mistray.trace.reliability import AimedSurface

NAMES = ("window_front", "window_rear", "L1_front", "L1_rear", "stop_wall", "detector")
PARTS = {name: name.partition("_")[0] for name in NAMES}
SURFACES = {name: GLASS for name in PARTS} | {"stop_wall": STRUCTURE, "detector": SENSOR, "(glass)": GLASS}
LENS = "window_front:T window_rear:T L1_front:T L1_rear:T"
WIDE = f"{LENS} detector:R L1_rear:T L1_front:T window_rear:R L1_front:T L1_rear:T detector:A"
ROUND = f"{LENS} detector:R L1_rear:R detector:A"
TWIN = f"{LENS} detector:R L1_rear:T L1_front:R L1_rear:T detector:A"
DETECTOR_ABSORBS = 0.8
EXTENT = (-2.0, 2.0, -1.5, 1.5)
SHAPE = (60, 80)
START_RAYS = 32_000
SETTINGS = asdict(Settings(rays=1000, max_events=32)) | {
    "azimuth_deg": 0.0,
    "wavelength_nm": [550.0],
    "variant": "llvm_ad_rgb",
    "polarization_reason": "no surface tells s from p",
    "versions": {"mistray": "0.1.0", "mitsuba": "3.9.1"},
}


@dataclass
class FakePath:
    """One path: a uniform disc of `radius` about (x, y) that holds `power` over `rays` rays."""

    events: str
    power: float
    rays: int
    x: float = 0.0
    y: float = 0.0
    radius: float = 0.1
    wavelength: float = 550.0
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    batch: np.ndarray = field(default_factory=lambda: np.empty(0))

    def spread(self, rng: np.random.Generator) -> None:
        r = self.radius * np.sqrt(rng.random(self.rays))
        phi = 2 * np.pi * rng.random(self.rays)
        self.points = np.column_stack([self.x + r * np.cos(phi), self.y + r * np.sin(phi)])
        self.batch = rng.integers(0, BATCHES, self.rays)

    def sums(self) -> np.ndarray:
        """What the ledger holds, in W."""
        power = np.full(self.rays, self.power / self.rays)
        return hit_sums(self.batch, power, *self.points.T, incident=power / DETECTOR_ABSORBS)


class FakeTrace:
    """The attributes of `mistray.trace.Trace` that reports read, of the same classes where there are any."""

    fewer_rays = ""

    def __init__(self, paths: list[FakePath], field_deg: float = 0.0, cut_events: float = 0.0, shares=None):
        rng = np.random.default_rng(1)
        self.fakes = sorted(paths, key=lambda path: -path.power)
        for path in self.fakes:
            path.spread(rng)
        detected = sum(path.power for path in self.fakes)
        self.paths = self._path_table()
        self.extent = EXTENT
        self.coating_error, self.own_notes = 0.0, []
        self.recorders, self.detectors = {}, ["detector"]
        self.tables = []  # no surfaces: a report of it says nothing of coatings
        self.shares = shares or {550.0: 1.0}
        self.wavelengths_nm = sorted(self.shares)
        self.settings = SETTINGS | {"field_deg": field_deg, "wavelength_nm": self.wavelengths_nm}
        self.irradiance, self.irradiance_se = self.irradiance_of(range(len(paths)))
        self.aiming, self.silent, self.largest_ray_share = [], [], math.nan
        self.scattered_rays_per_start, self.effective_scattered_rays = 0.0, 0.0
        self.energy = self._energy(detected, 1.0, cut_events)
        self.surfaces = self._surfaces(1.0)
        self.segments, self.seconds = 12345, 0.25

    def _path_table(self):
        """By the real thing: paths without light stand in for those of the other wavelengths."""
        events, lengths = encode([path.events for path in self.fakes], list(SURFACES))
        runs = []
        for line in sorted({path.wavelength for path in self.fakes} or {550.0}):
            sums = np.reshape([path.sums() * (path.wavelength == line) for path in self.fakes], (-1, BATCHES, SUMS))
            found, design = decoded(events, lengths, sums), [f"{LENS} detector:A"]
            runs.append(fake_run(SURFACES, found, rays=START_RAYS, wavelength_nm=line, design=design))
        table = path_table(runs)
        order = {(row.wavelength_nm, row.events): row.path_id for row in table}
        self.fakes.sort(key=lambda path: order[path.wavelength, path.events])
        return table

    def _energy(self, detected, share, cut_events):
        launched, glass = 5.0 * share, 0.02 * share
        absorbed = launched - detected - 1.25 * share - cut_events - 1e-6 * share - glass
        return Energy(
            launched_W=launched,
            detected_W=detected,
            detected_se_W=0.001 * detected,
            detected={"detector": (detected, 0.001 * detected)},
            absorbed={"stop_wall": (0.9 * absorbed, 1e-3), "L1_rear": (0.1 * absorbed, 1e-4)},
            absorbed_in={"N-BK7": (glass, 1e-5)},
            escaped_W=1.25 * share,
            escaped_se_W=0.01 * share,
            cut={"flux_threshold": 1e-6 * share, "max_events": cut_events, "max_reflections": 0.0, "medium": 0.0},
        )

    def _surfaces(self, share):
        return FluxReport(
            [
                SurfaceFlux(name, part, space, 1000, share * (5.0 - 0.5 * space), 0.01, 0.1 * share, 0.001)
                for space, (name, part) in enumerate(PARTS.items())
            ]
        )

    def _ids_at(self, wavelength_nm):
        return [k for k, path in enumerate(self.fakes) if path.wavelength == wavelength_nm]

    def irradiance_at(self, wavelength_nm):
        return self.irradiance_of(self._ids_at(wavelength_nm))

    def energy_at(self, wavelength_nm):
        detected = sum(self.fakes[k].power for k in self._ids_at(wavelength_nm))
        return self._energy(detected, self.shares[wavelength_nm], 0.0)

    def surfaces_at(self, wavelength_nm):
        return self._surfaces(self.shares[wavelength_nm])

    def sampled(self, path_ids):
        x0, x1, y0, y1 = EXTENT
        pixel = (x1 - x0) / SHAPE[1] * (y1 - y0) / SHAPE[0]
        by_batch, weights = np.zeros((*SHAPE, BATCHES)), np.zeros((3, *SHAPE))
        for path in (self.fakes[path_id] for path_id in path_ids):
            places = np.column_stack([path.points[:, ::-1], path.batch])
            limits = [(y0, y1), (x0, x1), (0, BATCHES)]
            counts, _ = np.histogramdd(places, bins=by_batch.shape, range=limits)
            one = path.power / path.rays / pixel
            by_batch += counts * one
            weights += np.array([1.0, one**2, one**4])[:, None, None] * counts.sum(axis=2)
        film = np.concatenate([np.moveaxis(by_batch, 2, 0), weights])
        return Pixels.of_film(film, np.full(BATCHES, START_RAYS / BATCHES))

    def irradiance_of(self, path_ids):
        found = self.sampled(path_ids)
        return found.value, found.se

    @property
    def light(self):
        return self.sampled(range(len(self.fakes)))

    def each_map(self, groups, with_noise):
        ids = [path_id for group in groups for path_id in group]
        assert len(ids) == len(set(ids)), "a path belongs to one map"
        assert len(with_noise) == len(groups)
        return (self.sampled(group) for group in groups)

    def light_cones(self, path_ids):
        """None: no path is so rich in rays that its cone is known."""
        return {}

    def sampled_rays(self, path_ids, n=8):
        return {path_id: [SimpleNamespace(points=ray) for ray in self.history(path_id, n).rays] for path_id in path_ids}

    def history(self, path_id, n=8):
        path, rays = self.fakes[path_id], []
        for start in np.linspace(-0.8, 0.8, n):
            knots = [[0.0, start, -2.0], [0.0, start, 0.0], [0.0, start * 0.9, 1.0]]
            if "detector:R" in path.events:
                knots += [[0.0, start * 0.5, 4.0], [0.0, start * 0.4, 1.0]]
            rays.append(np.array([*knots, [path.x, path.y, 5.0]]))
        return SimpleNamespace(rays=rays)


def paths_at(field_deg: float) -> list[FakePath]:
    """A field with a direct image (below 18 degrees), two ghosts, a structure path and one of very few rays."""
    y = 0.1 * field_deg
    paths = [
        FakePath(WIDE, 2e-4, 400, 0.0, -y, 0.5),
        FakePath(ROUND, 1e-4, 400, 0.0, y, 0.05),
        FakePath(f"stop_wall:R {LENS} detector:A", 3e-6, 100, 0.5, y, 0.3),
        FakePath(f"{LENS} stop_wall:R detector:A", 1e-9, 3, -1.0, 1.0, 1e-5),
    ]
    if abs(field_deg) < 18:
        paths.append(FakePath(f"{LENS} detector:A", 3.0, 1000, 0.0, y, 0.02))
    return paths


def trace_at(field_deg: float, cut_events: float = 0.0) -> FakeTrace:
    return FakeTrace(paths_at(field_deg), field_deg, cut_events)


def scatter_paths_at(field_deg: float) -> list[FakePath]:
    """Those of `paths_at`, and scattered light: by the window at random and aimed, by the stop, and by a ghost."""
    rear = "L1_front:T L1_rear:T detector:A"
    return [
        *paths_at(field_deg),
        FakePath(f"window_front:T window_rear:t {rear}", 3e-5, 50, 0.0, 0.0, 0.4),
        FakePath(f"window_front:T window_rear:i {rear}", 5e-5, 300, 0.0, 0.0, 0.6),
        FakePath(f"stop_wall:j {LENS} detector:A", 2e-5, 200, 0.3, 0.0, 0.5),
        FakePath("window_front:t window_rear:T L1_front:T L1_rear:i detector:A", 1e-6, 40, 0.0, 0.0, 0.5),
        FakePath(f"{LENS} detector:R window_rear:j {rear}", 4e-6, 60, 0.0, 0.0, 0.5),
    ]


def scatter_trace_at(field_deg: float) -> FakeTrace:
    t = FakeTrace(scatter_paths_at(field_deg), field_deg)
    t.aiming = [AimedSurface("window_rear", 1000.0, 800.0), AimedSurface("stop_wall", 1000.0, 50.0)]
    t.scattered_rays_per_start, t.effective_scattered_rays, t.largest_ray_share = 0.65, 400.0, 0.01
    return t


def ghosts_of(*traces: FakeTrace, nominal: FakeTrace | None = None) -> GhostReport:
    """The ghosts of fields, of which the first has the nominal image unless another trace has it."""
    return GhostReport(lens_scene(), {t.settings["field_deg"]: t for t in traces}, nominal or traces[0], {})


SHARES = {450.0: 0.25, 550.0: 0.5, 650.0: 0.25}


def trace_in_colours(field_deg: float) -> FakeTrace:
    """The paths of `paths_at` at 450, 550 and 650 nm; the ghost off the window is red: it lacks 450 nm."""
    paths = []
    for wavelength, share in SHARES.items():
        for path in paths_at(field_deg):
            if not ("window_rear:R" in path.events and wavelength == 450.0):
                step = 1e-3 * (wavelength - 550.0)  # lateral colour
                rays = max(round(path.rays * share), 2)
                paths.append(replace(path, power=path.power * share, rays=rays, x=path.x + step, wavelength=wavelength))
    return FakeTrace(paths, field_deg, shares=SHARES)


# Order of three ghosts by power, by RMS irradiance and by the brightest pixel.
# Discs of even irradiance: P/(π a²) is the peak and 2P/(π a²) the RMS irradiance, as r_rms² = a²/2
ORDERS = {"rms": (ROUND, WIDE, TWIN), "power": (WIDE, ROUND, TWIN), "peak": (TWIN, ROUND, WIDE)}


@cache
def _traced() -> FakeTrace:
    paths = []
    for x, line in ((-1.0, 450.0), (1.0, 650.0)):
        paths += [
            FakePath(WIDE, 5e-4, 100_000, 0.0, 0.0, 0.7071, line),  # 1 mW: peak 0.00063, RMS irradiance 0.0013
            FakePath(ROUND, 1e-4, 20_000, 0.0, 0.0, 0.2, line),  # 0.2 mW: peak 0.0016, RMS irradiance 0.0032
            FakePath(TWIN, 1e-4, 20_000, x, 0.0, 0.1, line),  # r_rms = 1 mm: peak 0.0032, RMS irradiance 0.00006
            FakePath(f"{LENS} detector:A", 1.0, 1000, 0.0, 0.0, 0.02, line),
        ]
    return FakeTrace(paths, shares={450.0: 0.5, 650.0: 0.5})


def ranked_report(rank: str = "rms") -> GhostReport:
    """One field with the three ghosts at two wavelengths; the halves of the twin are of one wavelength each."""
    trace = _traced()
    return GhostReport(lens_scene(), {0.0: trace}, trace, {}, rank)
