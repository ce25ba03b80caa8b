"""Filters, names and the table of paths from ledgers written by hand: algebra, errors, classes, ways of the light."""

import itertools
import re
import warnings
from collections.abc import Sequence
from operator import eq, ge, gt, le, lt, ne

import numpy as np
import pytest
import vectors
from command_line import fails
from fake_ledger import EDGE, GLASS, REFLECTOR, RING, SENSOR, STRUCTURE, decoded, design_of, encode, fake_run, hit_sums

import mistray
from mistray.analyses.pst.causes import stray_paths
from mistray.analyses.pst.tables import path_frame
from mistray.errors import MistrayError, MistrayWarning
from mistray.recorders.design_sequences import DesignSequences
from mistray.recorders.path_events import Events, describe_events
from mistray.scene.load import shipped_scenes
from mistray.settings import BATCHES
from mistray.trace.filter_rows import Rows
from mistray.trace.path_filter import PathFilter
from mistray.trace.paths import PathTable, path_table

pytestmark = pytest.mark.filterwarnings("ignore:.*few rays")

SURFACES = {"L1_front": GLASS, "L1_rear": GLASS, "L1_edge": EDGE, "barrel (black)": STRUCTURE, "primary": REFLECTOR}
SURFACES |= {"rim": RING, "detector": SENSOR, "(N-BK7)": GLASS}
PARTS = ["L1", "L1", "L1", "barrel", "primary", "stop", "detector", "N-BK7"]
LETTERS = "TRItrij"


def random_lists(count: int) -> list[list[tuple[str, str]]]:
    rng = np.random.default_rng(3)
    names = [name for name in SURFACES if name != "detector"]
    lists = []
    for _ in range(count):
        events = [(str(rng.choice(names)), str(rng.choice(list(LETTERS)))) for _ in range(rng.integers(0, 6))]
        lists.append([(n, "t" if n == "(N-BK7)" else what) for n, what in events] + [("detector", "A")])
    return lists


LISTS = random_lists(400)


@pytest.fixture(scope="module")
def rows() -> Rows:
    ids = list(SURFACES)
    lengths = np.array([len(row) for row in LISTS])
    codes, words = np.zeros((len(LISTS), lengths.max()), dtype=np.uint32), np.array(list(SURFACES.values()))
    for k, row in enumerate(LISTS):  # `encode` reads names without blanks
        safe = " ".join(f"{ids.index(name)}:{what}" for name, what in row)
        (found,), _ = encode([safe], [str(n) for n in range(len(ids))])
        codes[k, : len(found)] = found
    events = Events(codes, lengths, ids, words.astype(np.uint32), DesignSequences())
    facts = describe_events(events)
    power = np.random.default_rng(4).random(len(LISTS))
    columns = facts | {"power_W": power, "source": np.array(["sun", "moon"] * (len(LISTS) // 2), dtype=object)}
    return Rows(events, PARTS, columns, 7, frozenset({"flux_W"}))


def held(text: str, rows: Rows) -> list[bool]:
    return PathFilter(text).holds(rows).tolist()


def by_text(letters: str, name: str = "", but: tuple[str, ...] = ()) -> list[int]:
    return [sum(what in letters and n.startswith(name) and n not in but for n, what in row[:-1]) for row in LISTS]


NO_GHOST = ("primary", "barrel (black)")
FLAGS = {
    "H(L1_rear)": [n > 0 for n in by_text(LETTERS, "L1_rear")],
    "H(L1)": [n > 0 for n in by_text(LETTERS, "L1")],
    "H(*_rear)": [n > 0 for n in by_text(LETTERS, "L1_rear")],
    "H(?1_rear)": [n > 0 for n in by_text(LETTERS, "L1_rear")],
    "M(primary)": [n == 0 for n in by_text(LETTERS, "primary")],
    "T(L1_front)": [n > 0 for n in by_text("T", "L1_front")],
    "R(primary)": [n > 0 for n in by_text("RI", "primary")],
    "I": [n > 0 for n in by_text("I")],
    "G": [n > 0 for n in by_text("R", but=NO_GHOST)],
    "G = 2": [n == 2 for n in by_text("R", but=NO_GHOST)],
    "G(L1) >= 1": [n > 0 for n in by_text("R", "L1")],
    "S(barrel)": [n > 0 for n in by_text("trij", "barrel")],
    'S("barrel (black)")': [n > 0 for n in by_text("trij", "barrel")],
    "S(rim)": [n > 0 for n in by_text("rj", "rim")],
    "D(rim)": [n > 0 for n in by_text("ti", "rim")],
    "D(stop) & S": [a > 0 and b > 0 for a, b in zip(by_text("ti", "rim"), [
        x + y for x, y in zip(by_text("trij", but=("rim", "(N-BK7)")), by_text("rj", "rim"), strict=True)
    ], strict=True)],
    "B(N-BK7)": [n > 0 for n in by_text("t", "(N-BK7)")],
    "B": [n > 0 for n in by_text("t", "(N-BK7)")],
    "L(L1_edge)": [len(row) > 1 and row[-2][0] == "L1_edge" for row in LISTS],
    "H(detector)": [True] * len(LISTS),
    "H != 1": [len(row) != 1 for row in LISTS],
    "source = moon": [k % 2 == 1 for k in range(len(LISTS))],
    "source != 'm*n'": [k % 2 == 0 for k in range(len(LISTS))],
    "": [True] * len(LISTS),
}  # fmt: skip


def test_flags_and_columns(rows: Rows) -> None:
    for text, flags in FLAGS.items():
        assert held(text, rows) == flags, text
        assert text in ("H(detector)", "") or 0 < sum(flags) < len(LISTS), "the case tells something"
    power = rows.columns["power_W"]
    for sign, compare in {"<": lt, "<=": le, ">": gt, ">=": ge, "=": eq, "!=": ne}.items():
        assert held(f"power_W {sign} .5", rows) == compare(power, 0.5).tolist()
    assert held("power_W>1e-1&power_W<=+3E-1", rows) == ((power > 0.1) & (power <= 0.3)).tolist()
    assert held('kind = "ghost + scatter"', rows) == (rows.columns["kind"] == "ghost + scatter").tolist()
    # Text that looks like a number
    key = next(key for key in rows.columns["key"] if key.isdigit())
    assert held(f"key = {key}", rows) == (rows.columns["key"] == key).tolist()
    # Without blanks no quotation marks
    assert held("kind = *diffraction*", rows) == ["diffraction" in kind for kind in rows.columns["kind"]]
    assert held("power_W > -1e308", rows) == [True] * len(LISTS)
    texts = [" ".join(f"{name.replace(' ', '_')}:{what}" for name, what in row) + " " for row in LISTS]
    for words, pattern in (
        ("L1_front L1_rear:R", r"(^| )L1_front:. (.* )?L1_rear:R "),
        ("L1_rear:R L1_front:T detector:A", r"(^| )L1_rear:R (.* )?L1_front:T (.* )?detector:A "),
        ("L1_front L1_front", r"(^| )L1_front:. (.* )?L1_front:. "),
        ("L1", r"(^| )L1_\w+:. "),  # a part
        ("(N-BK7):t", r"(^| )\(N-BK7\):t "),
        ("L1_rear:r", r"(^| )L1_rear:[rj] "),  # aimed scatter follows the same path
        ("L1_rear:j", r"(^| )L1_rear:j "),
    ):
        expected = [re.search(pattern, text) is not None for text in texts]
        assert held(f'"{words}"', rows) == expected
        assert any(expected)
        assert not all(expected)


TERMS = "H(L1_rear)", "S(barrel)", "M(primary)", "I", "G = 1", "power_W > 0.6", "source = sun", "D", '"L1_front:T"'


def random_expression(rng: np.random.Generator, depth: int) -> tuple[str, str]:
    """The same expression for the filter and for Python, whose & ^ | bind in the same order."""
    if depth == 0 or rng.random() < 0.2:
        k = int(rng.integers(len(TERMS)))
        return TERMS[k], f"term[{k}]"
    if rng.random() < 0.25:
        ours, theirs = random_expression(rng, depth - 1)
        return f"!({ours})", f"(~({theirs}))"
    parts = [random_expression(rng, depth - 1) for _ in range(rng.integers(2, 4))]
    signs = [str(rng.choice(["&", "^", "|"])) for _ in parts[1:]]
    bracket = rng.random() < 0.5
    texts = []
    for which in (0, 1):
        text = parts[0][which]
        for sign, part in zip(signs, parts[1:], strict=True):
            text += f" {sign} {part[which]}"
        texts.append(f"({text})" if bracket else text)
    # Joined without brackets a part that is itself a join mixes with its neighbours, in both in the same way
    return texts[0], texts[1]


def test_algebra(rows: Rows) -> None:
    """400 random expressions, brackets and none, against NumPy."""
    term = [np.array(held(text, rows)) for text in TERMS]
    rng = np.random.default_rng(11)
    for _ in range(400):
        ours, theirs = random_expression(rng, 3)
        assert held(ours, rows) == eval(theirs, {"term": term}).tolist(), ours
    # With a column of rays a filter bounds: for every flux that the rays could have it lies between
    rng = np.random.default_rng(12)
    for _ in range(200):
        ours, _ = random_expression(rng, 3)
        ours = ours.replace("power_W > 0.6", "flux_W > 0.6").replace("G = 1", "flux_W < 0.2")
        certain, possible = PathFilter(ours).bounds(rows)
        assert not np.any(certain & ~possible)
        for flux in (0.1, 0.4, 0.9):
            known = Rows(rows.events, rows.parts, dict(rows.columns) | {"flux_W": np.full(len(LISTS), flux)}, 7)
            now = PathFilter(ours).holds(known)
            assert not np.any(certain & ~now)
            assert not np.any(now & ~possible)


def test_errors_name_the_filter_and_what_is_wrong(rows: Rows) -> None:
    for text, names in vectors.toml("filter_refusals.toml")["refused"]:
        with pytest.raises(mistray.MistrayError) as caught:
            PathFilter(text).holds(rows)
        message = str(caught.value)
        assert message.startswith(f"filter '{text}': ")
        assert all(name in message for name in names), message


NAMED = {"front": GLASS, "rear": GLASS, "mirror": REFLECTOR, "bevel": EDGE, "tube": STRUCTURE, "detector": SENSOR}
DESIGN = "front:T rear:T mirror:R detector:A"
NAMES = vectors.toml("path_names.toml")


def names_of(events: Sequence[str], *design: str) -> list[str]:
    codes, lengths = encode(events, list(NAMED))
    words = np.array(list(NAMED.values()), dtype=np.uint32)
    events = Events(codes, lengths, list(NAMED), words, design_of(NAMED, *design))
    return describe_events(events)["label"].tolist()


def test_names_follow_from_the_events_and_differ() -> None:
    """Written down by hand; and the same for each path by itself as in a table with all others."""
    assert names_of(list(NAMES), DESIGN) == list(NAMES.values())
    assert [names_of([events], DESIGN)[0] for events in NAMES] == list(NAMES.values())
    # Every event list of up to four events, 41 371 of them
    words = [f"{name}:{letter}" for name in ("front", "rear", "mirror", "tube") for letter in "TRtr"]
    words = [*(w for w in words if w not in ("mirror:T", "tube:T", "mirror:t", "tube:t")), "detector:R", "bevel:T"]
    lists = [" ".join([*some, "detector:A"]) for n in range(5) for some in itertools.product(words, repeat=n)]
    for design in ([DESIGN], []):
        assert len(set(names_of(lists, *design))) == len(lists)


@pytest.mark.parametrize("scene", ["phone_camera", "double_gauss_barrel", "cassegrain", "lens_and_reflector"])
def test_no_name_is_blank_or_given_twice_in_a_pst(scene: str) -> None:
    pst = mistray.pst(mistray.load(scene), [18.0, 20.0, 22.0, 24.0], rays=4_000)
    named: dict[str, str] = {}
    file = path_frame(pst)  # of pst_paths.csv
    assert (file.groupby("events")[["label", "key"]].nunique() == 1).all(axis=None)
    assert (file.groupby("key").events.nunique() == 1).all()
    for angle in pst.field_deg:
        rows = stray_paths(pst, angle)
        assert all(named.setdefault(*pair) == pair[1] for pair in zip(rows.events, rows.label, strict=True))
        assert rows.events.is_unique
        assert rows.label.is_unique
        assert rows.label.str.strip().astype(bool).all()


@pytest.mark.parametrize("scene", sorted(shipped_scenes()))
def test_every_path_of_a_trace_has_a_name_of_its_own(scene: str) -> None:
    """At two wavelengths, where the same events have the same name; in the ledger, its print and by ways."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MistrayWarning)  # of improbable scatter
        loaded = mistray.load(scene)
    paths = mistray.trace(loaded, field_deg=0.1, rays=512, wavelength_nm=[550.0, 600.0]).paths
    for table in (paths.to_pandas(), paths.by_way()):
        for _, rows in table.groupby(["source", "wavelength_nm"]):
            assert rows.label.is_unique
        assert table.groupby(["source", "events"]).label.nunique().max() == 1
        assert table.label.str.strip().astype(bool).all()
    for line, row in zip(str(paths).splitlines()[1:21], paths, strict=False):
        assert line.endswith(row.label)


@pytest.fixture(scope="module")
def scene():
    return mistray.coat("singlet_window_detector", {}, scatter={"window_front": ["harvey_shack rms_nm=5"]})


@pytest.fixture(scope="module")
def traced(scene) -> mistray.Trace:
    return mistray.trace(scene, rays=400, field_deg=1.0, wavelength_nm=[500.0, 600.0])


def test_printed_names_mean_their_rows_also_within_a_filter(traced) -> None:
    rows = traced.paths.by_way()
    chosen = [*range(12), *range(12, len(rows), len(rows) // 12)]
    assert any("scatter at" in rows.label[k] for k in chosen)
    assert any(":" in rows.label[k] for k in chosen)
    assert any(len(rows.path_ids[k]) == 2 for k in chosen), "light at random and aimed"
    for k in chosen:
        expected = {i for ids in rows.path_ids[rows.label == rows.label[k]] for i in ids}
        for text in (rows.label[k], rows.label[k].replace(" → ", "->")):
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                assert {row.path_id for row in traced.paths.select(text)} == expected, text
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = {row.events for row in traced.paths.select(rows.events[k])}
        assert found == {traced.paths[i].events for i in expected}
    label = next(row.label for row in traced.paths if row.label.startswith("detector →"))
    whole = traced.paths.select(label)
    assert len(whole) == 2, "one at each wavelength"
    assert traced.paths.select(f"'{label}' & wavelength_nm = 500") == [r for r in whole if r.wavelength_nm == 500.0]
    assert len(traced.rays(label, n=20)) == 20
    names = {row.label for row in traced.paths if row.label.startswith("detector → w")}
    with pytest.warns(mistray.MistrayWarning, match=f"means {len(names)} paths together") as told:
        rows = traced.paths.select("detector -> w*")
    assert ({row.label for row in rows}, [one.message.code for one in told]) == (names, ["several-paths"])
    label = next(row.label for row in traced.paths if row.label.startswith("detector →"))
    first, last = label.split(" → ")
    with pytest.warns(mistray.MistrayWarning, match=f"did you mean '{label}'") as told:
        assert traced.paths.select(f"{last} -> {first}") == []
    assert [one.message.code for one in told] == ["no-path"]


def test_wrong_names_are_refused_before_the_trace(scene, capsys) -> None:
    for call, near in (
        (lambda: mistray.optimize.path_power(scene, "detectr -> L1_front", rays=1e9), "'detector'"),
        (lambda: mistray.trace(scene, n_rays=1), "did you mean 'rays'"),
        (lambda: mistray.ghosts(scene, feild_deg=1), "did you mean 'field_deg'"),
        (lambda: mistray.sweep(scene, n_rays=1), "did you mean 'rays'"),
        (lambda: mistray.view(scene, pathids=[1]), "did you mean 'path_ids'"),
    ):
        with pytest.raises(mistray.MistrayError, match=near):
            call()
    for command, option in (("ghosts", "--filter"), ("view", "--path-ids"), ("sensitivity", "--paths")):
        wrong = [command, "singlet_window_detector", option, "L1_fron -> L1_rear", "--rays", "1e9"]
        assert "'L1_front'" in fails(capsys, *wrong)


LEDGER = {"L1_front": GLASS, "L1_rear": GLASS, "L1_edge": EDGE, "barrel": STRUCTURE, "primary": REFLECTOR}
LEDGER |= {"detector": SENSOR}
LENS = "L1_front:T L1_rear:T"
LEDGER_DESIGN = design_of(
    LEDGER, f"{LENS} detector:A", "primary:R detector:A", f"{LENS} primary:R L1_edge:I detector:A"
)


def facts(*lists: str) -> list[dict]:
    words = np.array(list(LEDGER.values()), dtype=np.uint32)
    columns = describe_events(Events(*encode(lists, list(LEDGER)), list(LEDGER), words, LEDGER_DESIGN))
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
    return path_table([fake_run(LEDGER, decoded(*encode(lists, list(LEDGER)), sums), unit, rays)])


WAYS = "T L1_rear:T, t L1_rear:T, i L1_rear:T, t barrel:r, i barrel:r, t barrel:j, i barrel:j, T barrel:j"
ENTRIES = [f"L1_front:{way} detector:A" for way in WAYS.split(", ")]
COUNTS, SCALES = [500, 200, 300, 10, 20, 30, 40, 100], [5.0, 1.0, 1.0, 0.1, 0.1, 0.1, 0.1, 0.2]


def test_one_way_is_one_row_with_the_numbers_of_all_its_light() -> None:
    """Power, centroid, radius, rays and error are those of a ledger that never told random light from aimed."""
    hits = Hits(np.random.default_rng(1), COUNTS, SCALES)
    table = table_of(ENTRIES, hits)
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
        assert (row.rays, row.power_W) == (chosen.sum(), pytest.approx(flux.sum(), rel=1e-12))
        assert (row.x_mm, row.y_mm, row.rms_radius_mm) == pytest.approx((x, y, radius), rel=1e-9)
        by_batch = np.bincount(hits.batch[chosen], flux, BATCHES)
        assert row.power_se_W == pytest.approx(np.std(by_batch, ddof=1) * np.sqrt(BATCHES), rel=1e-9)
        assert {table[path_id].events for path_id in row.path_ids} == {ENTRIES[number] for number in numbers}
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
        fake_run(LEDGER, decoded(*encode([ENTRIES[1], ENTRIES[2]], list(LEDGER)), np.array([hits.sums(hits.path == k)
                 for k in numbers])), wavelength_nm=nm)
        for nm, numbers in ((450.0, (1, 2)), (650.0, (3, 7)))
    ]  # fmt: skip
    rows = path_table(runs).by_way()
    assert (sorted(rows.wavelength_nm), [len(ids) for ids in rows.path_ids]) == ([450.0, 650.0], [2, 2])
    assert [row.path_id for row in table] == list(range(len(ENTRIES)))
    assert [row.path_id for row in (table[-1], *table[2:4])] == [len(ENTRIES) - 1, 2, 3]
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
    events = encode(["L1_front:t L1_rear:T detector:A", "L1_front:i L1_rear:T detector:A"], list(LEDGER))
    run = fake_run(LEDGER, decoded(*events, sums), 1.0, 3200)
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
    assert (table.power([]), table.power([7])) == ((0.0, 0.0), (table[7].power_W, table[7].power_se_W))
    assert power == pytest.approx(hits.flux.sum(), rel=1e-12)
    # 100 start rays scatter ten rays each, which land: by hits the error would be sqrt(10) too small; alarm < 1e-6
    rng = np.random.default_rng(5)
    batch = np.repeat(rng.integers(0, BATCHES, 100), 10)
    one = np.ones(len(batch))
    events = encode(["barrel:j detector:A"], list(LEDGER))
    run = fake_run(LEDGER, decoded(*events, hit_sums(batch, one, one, one)[None]), 1.0)
    (row,) = path_table([run])
    assert (row.rays, row.power_se_W) == (1000, pytest.approx(10 * np.sqrt(100), rel=5 / np.sqrt(62)))
