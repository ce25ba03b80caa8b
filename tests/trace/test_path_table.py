"""The path table from ledgers written down by hand: classes, ways of the light, errors of sums, and its speed."""

import numpy as np
import pytest
import vectors
from fake_ledger import EDGE, GLASS, REFLECTOR, SENSOR, STRUCTURE, decoded, design_of, encode, fake_run, hit_sums

from mistray.errors import MistrayError
from mistray.recorders.path_events import Events, describe_events
from mistray.settings import BATCHES
from mistray.trace.paths import PathTable, path_table

SURFACES = {"L1_front": GLASS, "L1_rear": GLASS, "L1_edge": EDGE, "barrel": STRUCTURE, "primary": REFLECTOR}
SURFACES |= {"detector": SENSOR}
LENS = "L1_front:T L1_rear:T"
DESIGN = design_of(SURFACES, f"{LENS} detector:A", "primary:R detector:A", f"{LENS} primary:R L1_edge:I detector:A")


def facts(*lists: str) -> list[dict]:
    words = np.array(list(SURFACES.values()), dtype=np.uint32)
    columns = describe_events(Events(*encode(lists, list(SURFACES)), list(SURFACES), words, DESIGN))
    return [{name: column[k] for name, column in columns.items()} for k in range(len(lists))]


def test_every_path_has_one_class() -> None:
    """Also where lists are filled up to the length of the longest: what stands there says nothing."""
    lists = [(events, kind) for kind, listed in vectors.toml("path_classes.toml").items() for events in listed]
    for row, (events, kind) in zip(facts(*(events for events, _ in lists)), lists, strict=True):
        assert (row["kind"], row["events"]) == (kind, events)
        assert row["path"] == "".join(word[-1] for word in events.split())
        assert row == facts(events)[0]
    # Surfaces are named in the order of the light
    names = ("ghost_1", "ghost_2", "scatter_1", "edges", "scatters", "order", "structure_bounces", "tir")
    long = "barrel:R L1_front:i L1_rear:R L1_front:R primary:R barrel:r detector:A"
    for events, expected in (
        ("L1_front:T detector:R L1_rear:R detector:A", ["detector", "L1_rear", "-", "-", 0, 2, 0, 0]),
        ("L1_front:T barrel:j L1_rear:t detector:A", ["-", "-", "barrel", "-", 2, 0, 0, 0]),
        (long, ["barrel", "L1_rear", "L1_front", "-", 2, 2, 1, 0]),
        ("primary:R detector:A", ["-", "-", "-", "-", 0, 0, 0, 0]),
        ("L1_edge:T L1_rear:I L1_edge:T detector:A", ["-", "-", "-", "L1_edge L1_edge", 0, 0, 0, 1]),
        ("barrel:r L1_edge:t detector:A", ["-", "-", "barrel", "L1_edge", 2, 0, 0, 0]),
    ):
        (row,) = facts(events)
        assert [row[name] for name in names] == expected


class Hits:
    """Random hits of the detector by some paths: path, batch, absorbed flux and place of each."""

    def __init__(self, rng: np.random.Generator, counts: list[int], scales: list[float]) -> None:
        self.path = np.repeat(np.arange(len(counts)), counts)
        self.batch = rng.integers(0, BATCHES, len(self.path))
        self.flux = np.array(scales)[self.path] * rng.random(len(self.path))
        self.x, self.y = rng.normal(size=(2, len(self.path))) + self.path

    def sums(self, chosen: np.ndarray) -> np.ndarray:
        return hit_sums(self.batch[chosen], self.flux[chosen], self.x[chosen], self.y[chosen])


def table_of(lists: list[str], hits: Hits, unit: float = 2.0, rays: int = 32_000) -> PathTable:
    sums = np.array([hits.sums(hits.path == k) for k in range(len(lists))])
    return path_table([fake_run(SURFACES, decoded(*encode(lists, list(SURFACES)), sums), unit, rays)])


WAYS = "T L1_rear:T, t L1_rear:T, i L1_rear:T, t barrel:r, i barrel:r, t barrel:j, i barrel:j, T barrel:j"
LISTS = [f"L1_front:{way} detector:A" for way in WAYS.split(", ")]
COUNTS, SCALES = [500, 200, 300, 10, 20, 30, 40, 100], [5.0, 1.0, 1.0, 0.1, 0.1, 0.1, 0.1, 0.2]


@pytest.fixture
def hits() -> Hits:
    return Hits(np.random.default_rng(1), COUNTS, SCALES)


def test_one_way_is_one_row_with_the_numbers_of_all_its_light(hits: Hits) -> None:
    """Power, centroid, radius, rays and error are those of a ledger that never told random light from aimed."""
    table = table_of(LISTS, hits)
    rows = table.by_way()
    ways = ("T L1_rear:T", "t L1_rear:T", "T barrel:r", "t barrel:r")
    assert list(rows.events) == [f"L1_front:{way} detector:A" for way in ways]
    assert list(rows.path) == ["TTA", "tTA", "TrA", "trA"]
    groups = {"tTA": [1, 2], "trA": [3, 4, 5, 6]}
    for path, numbers in groups.items():
        (row,) = rows[rows.path == path].itertuples(index=False)
        chosen = np.isin(hits.path, numbers)
        flux = 2 * hits.flux[chosen]
        x, y = (np.average(v[chosen], weights=flux) for v in (hits.x, hits.y))
        radius = np.sqrt(np.average((hits.x[chosen] - x) ** 2 + (hits.y[chosen] - y) ** 2, weights=flux))
        assert row.rays == chosen.sum()
        assert row.power_W == pytest.approx(flux.sum(), rel=1e-12)
        assert (row.x_mm, row.y_mm, row.rms_radius_mm) == pytest.approx((x, y, radius), rel=1e-9)
        by_batch = np.bincount(hits.batch[chosen], flux, BATCHES)
        assert row.power_se_W == pytest.approx(np.std(by_batch, ddof=1) * np.sqrt(BATCHES), rel=1e-9)
        assert {table[path_id].events for path_id in row.path_ids} == {LISTS[number] for number in numbers}
        assert row.path_id == min(row.path_ids)
    assert rows.percent.sum() == pytest.approx(100, rel=1e-12)
    # The error of a share knows that the path is in the whole: the spread of what is left of both
    share = rows.power_W.iloc[1] / rows.power_W.sum()
    flux = 2 * hits.flux * (np.isin(hits.path, groups["tTA"]) - share)
    spread = np.std(np.bincount(hits.batch, flux, BATCHES), ddof=1) * np.sqrt(BATCHES)
    assert rows.percent_se.iloc[1] == pytest.approx(100 * spread / rows.power_W.sum(), rel=1e-9)
    assert sorted(path_id for ids in rows.path_ids for path_id in ids) == list(range(len(table)))
    assert rows.power_W.is_monotonic_decreasing
    runs = [
        fake_run(SURFACES, decoded(*encode([LISTS[1], LISTS[2]], list(SURFACES)), np.array([hits.sums(hits.path == k)
                 for k in numbers])), wavelength_nm=nm)
        for nm, numbers in ((450.0, (1, 2)), (650.0, (3, 7)))
    ]  # fmt: skip
    rows = path_table(runs).by_way()
    assert sorted(rows.wavelength_nm) == [450.0, 650.0]
    assert [len(ids) for ids in rows.path_ids] == [2, 2]
    table = table_of(LISTS, hits)
    assert [row.path_id for row in table] == list(range(len(LISTS)))
    assert table[-1] == table[len(LISTS) - 1]
    assert table[2:4] == [table[2], table[3]]
    assert table[0].event_list == [("L1_front", "SpecTran"), ("L1_rear", "SpecTran"), ("detector", "Absorbed")]
    assert next(row for row in table if row.path == "TjA").event_list[1] == ("barrel", "ImpRefl")
    with pytest.raises(IndexError, match="row 8 of a table of 8 paths"):
        table[8]
    with pytest.raises(MistrayError, match="path_id 8 does not exist"):
        table.located([8])
    assert {row.path for row in table.find("barrel:j")} == {"TjA", "tjA", "ijA"}
    assert len(table.find("L1_front", "barrel")) == 5
    assert table.power([1, 2, 1]) == table.power([1, 2])
    assert table.light([1, 1]).whole == table.light(1).whole
    assert table.numbers([[2, 1, 2]]).columns["power_W"] == table.numbers([[2, 1]]).columns["power_W"]


def test_the_error_of_a_sum() -> None:
    """Light in both paths or in none: their errors, within 1 ± 5 sqrt(1/62) but for one in 2e6, add up linearly."""
    rng = np.random.default_rng(3)
    start = rng.permutation(3200)[:640]
    batch = start % BATCHES
    one = np.ones(len(start))
    sums = np.array([hit_sums(batch, one, 0 * one, 0 * one), hit_sums(batch, 2 * one, 0 * one, 0 * one)])
    events = encode(["L1_front:t L1_rear:T detector:A", "L1_front:i L1_rear:T detector:A"], list(SURFACES))
    run = fake_run(SURFACES, decoded(*events, sums), 1.0, 3200)
    table = path_table([run])
    power, se = table.power([0, 1])
    assert power == pytest.approx(3 * 640, rel=1e-12)
    assert se == pytest.approx(3 * np.sqrt(640 * (1 - 640 / 3200)), rel=5 / np.sqrt(62))
    assert se == pytest.approx(table[0].power_se_W + table[1].power_se_W, rel=1e-9)
    assert table.by_way().power_se_W[0] == pytest.approx(se, rel=1e-12)
    # 40 paths of equal numbers of hits: the linear sum of their errors would be 6 times too large
    rng = np.random.default_rng(4)
    lists = [f"barrel:r {' '.join(['L1_rear:T'] * k)} detector:A" for k in range(40)]
    hits = Hits(rng, [225] * len(lists), [1.0] * len(lists))
    table = table_of(lists, hits, unit=1.0, rays=10_000_000)
    power, se = table.power(range(len(lists)))
    assert se == pytest.approx(np.sqrt(np.sum(hits.flux**2)), rel=5 / np.sqrt(62))
    assert table.power([]) == (0.0, 0.0)
    assert table.power([7]) == (table[7].power_W, table[7].power_se_W)
    assert power == pytest.approx(hits.flux.sum(), rel=1e-12)
    # 100 start rays scatter ten rays each, which land: by hits the error would be sqrt(10) too small; alarm < 1e-6
    rng = np.random.default_rng(5)
    batch = np.repeat(rng.integers(0, BATCHES, 100), 10)
    one = np.ones(len(batch))
    events = encode(["barrel:j detector:A"], list(SURFACES))
    run = fake_run(SURFACES, decoded(*events, hit_sums(batch, one, one, one)[None]), 1.0)
    (row,) = path_table([run])
    assert row.rays == 1000
    assert row.power_se_W == pytest.approx(10 * np.sqrt(100), rel=5 / np.sqrt(62))
