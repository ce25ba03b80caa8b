"""Backward traces: balance, books of paths, passes that add up, and the tables made of them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np
import pytest
from oracles.scatter_scenes import beam_xml, bsdf_xml, placed_xml, scatter_scene, scattering_xml
from oracles.small_scenes import interface_xml
from oracles.statistics import assert_z

import mistray
from mistray import MistrayError
from mistray.analysis.pst.found_paths import _strongest, forward_events
from mistray.execute import backward
from mistray.execute.backward import BackwardTrace
from mistray.execute.seen import Seen, see
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.path_key import ABSORBED, EVENT_BITS, RANDOM_REFLECTED, REFLECTED, TRANSMITTED, host_keys
from mistray.recorders.path_sums import join_sums
from mistray.settings import BATCHES, Settings

RAYS = 4096
GRID = DirectionGrid.of([0.0, 20.0, 50.0, 75.0], cell_deg=10.0)
HEMISPHERE = DirectionGrid.of([15.0, 45.0, 75.0], cell_deg=30.0)


def traced(scene: Any, grid: DirectionGrid = GRID, passes: int = 1, rays: int = RAYS, **arguments: Any) -> Any:
    """A trace after some passes; arguments are those of `BackwardTrace` and the settings."""
    own = {
        key: arguments.pop(key) for key in ("paths", "both_sides", "wavelength_nm", "map_pixels") if key in arguments
    }
    trace = BackwardTrace(scene, grid, Settings.of(scene, **arguments), **own)
    for _ in range(passes):
        trace.advance(rays)
    return trace


def bare(*more: str) -> str:
    """A round detector under the open sky, with a beam on it."""
    return scatter_scene(
        beam_xml(0.5), placed_xml("asphere", "detector", at=(0.0, 0.0, 2.0), pixels=4, semi_diameter=1.0), *more
    )


@pytest.fixture(scope="module")
def wall_scene() -> Any:
    return mistray.load("plate_and_wall")


# -- balance -------------------------------------------------------------------------------------------------------


def balance(seen: Seen) -> tuple[float, float]:
    """Emission, media, escaped and lost together, with the standard error from the batches."""
    by_batch = sum(row.emission_by_batch for row in seen.rows)
    by_batch = by_batch + sum(part[2] for part in seen.media.values()) + seen.escaped[2] + seen.lost[2]
    return float(np.mean(by_batch)), float(np.std(by_batch, ddof=1) / np.sqrt(BATCHES))


class TestSee:
    @pytest.mark.parametrize("name", ["plate_and_wall", "newtonian_scatter", "cooke_triplet"])
    def test_all_is_somewhere(self, name: str) -> None:
        """Emission + media + escaped + lost = 1 in vacuum, 4 standard errors (false alarm 6e-5), 1e-5 for rounding."""
        seen = see(mistray.load(name), rays=20_000, max_scatters=2)
        total, error = balance(seen)
        assert_z(name, total, 1.0, error, k=4.0, floor=1e-5)
        assert error < 0.02
        parts = [row.emission for row in seen.rows] + [value for value, *_ in seen.media.values()]
        assert total == pytest.approx(sum(parts) + seen.escaped[0] + seen.lost[0], rel=1e-9)
        assert seen.escaped[0] > 0
        for row in seen.rows:
            assert row.share >= row.emission * (1 - 1e-6)
            assert row.emission >= 0

    @pytest.mark.parametrize(
        "limits",
        [
            {"max_events": 3},
            {"max_reflections": 0, "max_scatters": 0},
            {"flux_threshold": 0.05},
            {"flux_threshold": 0.05, "below_threshold": "roulette"},
            {"ray_control": "transmit_specular"},
            {"ray_control": "halt_all"},
            {"splitting": "one"},
            {"max_scatters": 3},
        ],
        ids=str,
    )
    @pytest.mark.parametrize("name", ["plate_and_wall", "cooke_triplet"])
    def test_limits_and_chances_are_booked(self, name: str, limits: dict[str, Any]) -> None:
        """Without aiming every start ray weighs 1, so that the balance holds in each batch: to 1e-5."""
        seen = see(mistray.load(name), rays=3200, aim="none", **limits)
        total, error = balance(seen)
        assert total == pytest.approx(1.0, abs=1e-5)
        assert error < 1e-6

    def test_in_glass_it_is_the_squared_index(self, load_scene) -> None:
        """A detector in a block of n = 1.5: 2.25; what leaves by the face is the étendue, T of the sky."""
        block = scatter_scene(
            beam_xml(0.5),
            placed_xml("asphere", "face", interface_xml("air", "1.5"), semi_diameter=5.0),
            placed_xml("frustum", "wall", interface_xml("1.5", "air", R=0.0), r0=5.0, z0=0.0, r1=5.0, z1=2.0),
            placed_xml("asphere", "detector", at=(0.0, 0.0, 2.0), pixels=4, semi_diameter=5.0),
        )
        seen = see(load_scene(block), rays=20_000)
        total, error = balance(seen)
        assert_z("block", total, 2.25, error, k=4.0, floor=3e-5)
        assert seen.escaped[0] < 1.0

    @pytest.mark.parametrize("aim", ["auto", "none"])
    def test_under_the_open_sky_all_escapes(self, load_scene, aim: str) -> None:
        """False alarm 6e-5."""
        seen = see(load_scene(bare()), rays=20_000, aim=aim)
        assert_z("escaped", seen.escaped[0], 1.0, seen.escaped[1], k=4.0, floor=1e-6)
        assert [row.hits for row in seen.rows] == [0]
        assert seen.lost[0] == 0
        assert seen.media == {}
        assert seen.detector_area_mm2 == pytest.approx(np.pi, rel=1e-6)

    def test_half_of_the_sky_behind_a_black_wall(self, load_scene) -> None:
        """A wall through the middle of the detector and across it: one half of the rays, 1 % (5 errors or more)."""
        wall = {"at": (0.0, 0.0, -1e4 + 1.99), "facing": (1.0, 0.0, 0.0), "half_width": 1e4, "half_height": 1e4}
        seen = see(load_scene(bare(placed_xml("asphere", "wall", **wall))), rays=20_000, aim="none")
        (share,) = (row.emission for row in seen.rows if row.id == "wall")
        assert share + seen.escaped[0] == pytest.approx(1.0, abs=1e-5)
        assert share == pytest.approx(0.5, abs=0.02)

    def test_rays_and_wavelength(self, load_scene) -> None:
        seen = see(load_scene(bare()), rays=3200, wavelength_nm=633.0)
        assert (seen.rays, seen.wavelength_nm, seen.detector) == (3200, 633.0, "detector")


class TestBareDetector:
    """Cells of a Lambertian detector in closed form: sin² of the edges."""

    @pytest.mark.parametrize("aim", ["auto", "none"])
    def test_cells(self, load_scene, aim: str) -> None:
        """4 standard errors, false alarm 2e-4."""
        trace = traced(load_scene(bare()), GRID, rays=32_768, aim=aim, both_sides=False)
        by_batch = trace.sums["cells"].sum(axis=(0, 2)) / trace.rays
        low, high = np.sin(np.radians(GRID.edges_deg)).T ** 2
        error = by_batch.std(axis=1, ddof=1) / np.sqrt(BATCHES)
        assert_z("cells", by_batch.mean(axis=1), high - low, error, k=4.0)
        everywhere = by_batch.sum(axis=0) + trace.sums["elsewhere"] / trace.rays
        assert_z("sum", everywhere.mean(), 1.0, everywhere.std(ddof=1) / np.sqrt(BATCHES), k=4.0, floor=1e-6)

    def test_halves(self, load_scene) -> None:
        """Of rays to both sides one half of the sky gets 1, the other 1; without aiming exactly."""
        trace = traced(load_scene(bare()), HEMISPHERE, aim="none", both_sides=True)
        rays = trace.rays.sum()
        assert trace.sums["cells"].sum() / rays == pytest.approx(1.0, abs=1e-6)
        assert trace.sums["elsewhere"].sum() / rays == pytest.approx(1.0, abs=1e-6)
        one = traced(load_scene(bare()), HEMISPHERE, aim="none", both_sides=False)
        assert one.sums["cells"].sum() / one.rays.sum() == pytest.approx(1.0, abs=1e-6)
        assert one.sums["elsewhere"].sum() == 0

    def test_light_that_meets_nothing_is_the_image(self, load_scene) -> None:
        trace = traced(load_scene(bare()), HEMISPHERE)
        assert trace.design.lists == {trace.table.detector: ((),)}
        assert np.all(trace.sums["cells"][0].sum(axis=(1, 2)) > 0)
        assert not trace.sums["cells"][1:].any()


# -- the book of paths ---------------------------------------------------------------------------------------------


def cell_sums(trace: BackwardTrace) -> np.ndarray:
    return trace.sums["cells"].sum(axis=(0, 3)).ravel()


class TestPathBook:
    SETTINGS = {"paths": True, "max_scatters": 2, "max_reflections": 2}
    CELLS = DirectionGrid.of([0.0, 20.0, 50.0, 75.0], [0.0, 90.0, 180.0, 270.0], cell_deg=10.0)

    def test_listed_paths_add_up_to_the_cells(self, wall_scene) -> None:
        trace = traced(wall_scene, self.CELLS, passes=2, **self.SETTINGS)
        book = trace.paths()
        cells = cell_sums(trace)
        assert np.all(cells > 0)
        np.testing.assert_allclose(np.bincount(book["cell"], book["weight"], len(cells)), cells, rtol=1e-9)
        assert len(book["events"]) == len(book["lengths"]) > 20
        assert np.all(book["squares"] >= book["weight"] ** 2 / book["hits"] * (1 - 1e-9))
        assert len(np.unique(book["path"] * len(cells) + book["cell"])) == len(book["cell"])
        kinds = book["events"] & ((1 << EVENT_BITS) - 1)
        assert set(np.unique(kinds[np.arange(kinds.shape[1]) < book["lengths"][:, None]])) <= set(range(1, 6))

    def test_full_book_leaves_out_paths_and_nothing_else(self, wall_scene, monkeypatch) -> None:
        whole = traced(wall_scene, self.CELLS, **self.SETTINGS)
        monkeypatch.setattr(backward, "PATH_SLOTS", 16)
        monkeypatch.setattr(backward, "ENTRY_SLOTS", 64)
        small = traced(wall_scene, self.CELLS, **self.SETTINGS)
        np.testing.assert_allclose(small.sums["cells"], whole.sums["cells"], rtol=1e-12)
        book = small.paths()
        assert 0 < len(book["lengths"]) <= 16 < len(whole.paths()["lengths"])
        assert 0 < len(book["cell"]) <= 64
        listed, cells = np.bincount(book["cell"], book["weight"], len(cell_sums(small))), cell_sums(small)
        assert np.all(listed <= cells * (1 + 1e-9))
        assert listed.sum() < 0.999 * cells.sum()

    def test_book_changes_no_sum(self, wall_scene) -> None:
        """A trace without it counts the same, to 1e-12."""
        plain = traced(wall_scene, self.CELLS, **(self.SETTINGS | {"paths": False}))
        assert plain.paths() is None
        np.testing.assert_allclose(
            plain.sums["cells"], traced(wall_scene, self.CELLS, **self.SETTINGS).sums["cells"], rtol=1e-12
        )


# -- passes --------------------------------------------------------------------------------------------------------


def assert_same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> None:
    """Sums are of the same numbers in another order."""
    assert set(first) == set(second)
    for key, values in first.items():
        scale = np.max(np.abs(values), initial=1e-300)
        np.testing.assert_allclose(second[key], values, rtol=1e-12, atol=1e-12 * scale, err_msg=key)


class TestPasses:
    SETTINGS = {"max_scatters": 2, "map_pixels": 3}

    def test_same_seed_same_sums(self, wall_scene) -> None:
        first, again = (traced(wall_scene, passes=2, seed=5, **self.SETTINGS) for _ in range(2))
        assert_same(first.sums, again.sums)
        other = traced(wall_scene, passes=2, seed=6, **self.SETTINGS)
        assert np.any(other.sums["cells"] != first.sums["cells"])

    def test_passes_are_of_their_own(self, wall_scene) -> None:
        """The second pass is no copy of the first."""
        one, two = (traced(wall_scene, passes=passes, **self.SETTINGS) for passes in (1, 2))
        assert two.rays.sum() == 2 * one.rays.sum() == 2 * RAYS
        difference = two.sums["cells"] - 2 * one.sums["cells"]
        assert np.count_nonzero(difference) > 0.5 * np.count_nonzero(one.sums["cells"])

    def test_going_on_is_exact(self, wall_scene) -> None:
        whole = traced(wall_scene, passes=3, **self.SETTINGS)
        begun = traced(wall_scene, passes=2, **self.SETTINGS)
        resumed = traced(wall_scene, passes=0, **self.SETTINGS)
        before = {key: values.copy() for key, values in begun.sums.items()}
        resumed.go_on_from(begun.sums, begun.passes, 7.5)
        resumed.advance(RAYS)
        assert_same(whole.sums, resumed.sums)
        assert resumed.passes == 3
        assert resumed.seconds > 7.5
        assert_same(before, begun.sums)  # the other trace keeps its own

    def test_several_wavelengths_share_the_rays(self, wall_scene) -> None:
        trace = traced(wall_scene, wavelength_nm=[450.0, 600.0])
        assert trace.weights == (0.5, 0.5)
        assert trace.rays.sum() == RAYS
        assert trace.sums["channels"].shape[1] == BATCHES

    def test_size_of_the_passes(self, wall_scene) -> None:
        trace = traced(wall_scene, passes=0)
        sizes = []
        for passes in range(26):
            trace.passes = passes
            sizes.append(trace.next_pass)
        assert sizes == [2**14] * 8 + [2**15] * 4 + [2**16] * 4 + [2**17] * 4 + [2**18] * 6
        # No pass is longer than a quarter of all before, but for the first ones
        before = np.cumsum(sizes)[3:-1]
        assert np.all(sizes[4:] <= before / 4)

    def test_maps_add_up_to_the_cells(self, wall_scene) -> None:
        trace = traced(wall_scene, **self.SETTINGS)
        np.testing.assert_allclose(trace.sums["maps"][0].sum(axis=2).ravel(), cell_sums(trace), rtol=1e-12)

    def test_another_seed_and_other_angles_compile_nothing(self, wall_scene) -> None:
        traced(wall_scene, seed=1, rays=1024)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            other = DirectionGrid.of([3.0, 30.0, 40.0, 88.0], cell_deg=4.0)
            traced(wall_scene, other, seed=2, rays=1024, passes=2, flux_threshold=1e-5)
            kernels = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
        assert kernels
        fresh = [entry for entry in kernels if not entry["cache_hit"]]
        assert not fresh, f"{len(fresh)} of {len(kernels)} kernels were compiled anew"


# -- fingerprint ---------------------------------------------------------------------------------------------------


def lens_text(radius: float = 30.0, reflectance: float = 0.02, b: float = 1e-3, index: str = "1.5") -> str:
    rough = bsdf_xml("abg", A=1e-4, B=b, g=2.0)
    front = scattering_xml([rough], "air", index, R=reflectance, T=0.95)
    return scatter_scene(
        beam_xml(2.0),
        placed_xml("asphere", "front", front, radius=radius, semi_diameter=4.0),
        placed_xml("asphere", "rear", interface_xml(index, "air"), at=(0, 0, 3), semi_diameter=4.0),
        placed_xml("asphere", "detector", at=(0, 0, 40), pixels=4, semi_diameter=2.0),
    )


class TestFingerprint:
    def of(self, load_scene: Any, **changes: Any) -> str:
        scene = load_scene(lens_text(**changes))
        return BackwardTrace(scene, GRID, Settings(max_scatters=1)).fingerprint

    @pytest.mark.parametrize("change", [{"radius": 30.001}, {"reflectance": 0.021}, {"b": 1.01e-3}, {"index": "1.501"}])
    def test_it_changes_with_the_scene(self, load_scene, change: dict[str, Any]) -> None:
        assert self.of(load_scene, **change) != self.of(load_scene)

    def test_it_does_not_change_otherwise(self, load_scene) -> None:
        assert self.of(load_scene) == self.of(load_scene)

    def test_it_does_not_change_with_seed_or_rays(self, load_scene) -> None:
        scene = load_scene(lens_text())
        first = BackwardTrace(scene, GRID, Settings(seed=1))
        before = first.fingerprint
        first.advance(1024)
        assert first.fingerprint == before == BackwardTrace(scene, HEMISPHERE, Settings(seed=2, rays=7)).fingerprint

    def test_wavelengths_count(self, load_scene) -> None:
        scene = load_scene(lens_text(index="N-BK7"))
        prints = {
            BackwardTrace(scene, GRID, Settings(), wavelength_nm).fingerprint
            for wavelength_nm in (500.0, 600.0, [500.0, 600.0])
        }
        assert len(prints) == 3


# -- settings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"polarization": "stokes"}, "polarization is 'stokes'; .* unpolarised light only"),
        ({"max_random_scatters": 1}, "max_random_scatters is 1; .* use max_scatters"),
    ],
)
def test_settings_that_are_refused(wall_scene, settings: dict[str, Any], words: str) -> None:
    with pytest.raises(MistrayError, match=words) as caught:
        BackwardTrace(wall_scene, GRID, Settings(**settings))
    assert "\n" not in str(caught.value)
    with pytest.raises(MistrayError, match=words):
        see(wall_scene, rays=100, **settings)


def test_too_many_cells_for_paths(wall_scene) -> None:
    grid = DirectionGrid.of(np.linspace(0, 90, 200), np.linspace(0, 359, 200))
    with pytest.raises(MistrayError, match="131072 paths in 40000 cells are too many") as caught:
        BackwardTrace(wall_scene, grid, Settings(), paths=True)
    assert "\n" not in str(caught.value)


# -- tables of paths -----------------------------------------------------------------------------------------------


def code(surface: int, what: int) -> int:
    return (surface << EVENT_BITS) | what


A, B, C = code(1, TRANSMITTED), code(2, REFLECTED), code(3, RANDOM_REFLECTED)


def test_forward_events() -> None:
    """Events are turned round and end in the detector, number 7; the rest is filled up with zeros."""
    events = np.array([[A, B, C], [C, 0, 0], [0, 0, 0], [B, A, 0]], dtype=np.uint32)
    end = code(7, ABSORBED)
    turned, lengths = forward_events(events, np.array([3, 1, 0, 2]), 7)
    np.testing.assert_array_equal(turned, [[C, B, A, end], [C, end, 0, 0], [end, 0, 0, 0], [A, B, end, 0]])
    np.testing.assert_array_equal(lengths, [4, 2, 1, 3])
    assert turned.dtype == np.uint32


def test_forward_events_without_events() -> None:
    """A table whose only path meets nothing has no columns."""
    turned, lengths = forward_events(np.zeros((1, 0), dtype=np.uint32), np.array([0]), 2)
    np.testing.assert_array_equal(turned, [[code(2, ABSORBED)]])
    np.testing.assert_array_equal(lengths, [1])


def book(events: list[list[int]], entries: list[tuple[int, int, float, float, float]]) -> dict[str, np.ndarray]:
    """A table like that of `PathSums.read`; entries: path, cell, hits, weight, squares."""
    longest = max(map(len, events), default=0)
    padded = np.zeros((len(events), longest), dtype=np.uint32)
    for row, codes in zip(padded, events, strict=True):
        row[: len(codes)] = codes
    path, cell, hits, weight, squares = np.array(entries, dtype=np.float64).reshape(-1, 5).T
    numbers = {"path": path.astype(np.int64), "cell": cell.astype(np.int64)}
    lengths = np.array([len(row) for row in events], dtype=np.int64)
    return {"events": padded, "lengths": lengths, **numbers, "hits": hits, "weight": weight, "squares": squares}


def contents(book: dict[str, np.ndarray]) -> dict[tuple[tuple[int, ...], int], tuple[float, float, float]]:
    """(Event list, cell) → sums."""
    lists = [tuple(row[:length].tolist()) for row, length in zip(book["events"], book["lengths"], strict=True)]
    sums = zip(book["hits"].tolist(), book["weight"].tolist(), book["squares"].tolist(), strict=True)
    return {(lists[p], c): v for p, c, v in zip(book["path"].tolist(), book["cell"].tolist(), sums, strict=True)}


def assert_contents(found: dict[str, np.ndarray], expected: dict[Any, tuple[float, float, float]]) -> None:
    listed = contents(found)
    assert set(listed) == set(expected)
    for key, values in expected.items():
        assert listed[key] == pytest.approx(values, rel=1e-9)


def test_join_books() -> None:
    """A path of both is one path, in another order and with longer rows too."""
    first = book([[A, B], [C]], [(0, 0, 2, 1.0, 0.5), (0, 3, 1, 4.0, 16.0), (1, 0, 1, 0.25, 0.0625)])
    second = book([[C], [A, B, C], [A, B]], [(0, 0, 3, 0.5, 0.1), (1, 2, 1, 8.0, 64.0), (2, 3, 1, 1.0, 1.0)])
    joined = join_sums(first, second)
    expected = {
        ((A, B), 0): (2, 1.0, 0.5),
        ((A, B), 3): (2, 5.0, 17.0),
        ((C,), 0): (4, 0.75, 0.1625),
        ((A, B, C), 2): (1, 8.0, 64.0),
    }
    assert_contents(joined, expected)
    assert len(joined["lengths"]) == 3
    assert len(np.unique(host_keys(joined["events"], joined["lengths"]))) == 3
    assert_contents(join_sums(second, first), expected)


def test_join_books_with_an_empty_one() -> None:
    full, empty = book([[A, B]], [(0, 1, 1, 2.0, 4.0)]), book([], [])
    for joined in (join_sums(full, empty), join_sums(empty, full)):
        assert_contents(joined, contents(full))


def test_joined_books_of_two_traces_are_the_book_of_both(wall_scene) -> None:
    """What a run that goes on makes of its two halves."""
    settings = {"paths": True, "max_scatters": 1}
    whole = traced(wall_scene, passes=2, **settings)
    begun = traced(wall_scene, passes=1, **settings)
    resumed = traced(wall_scene, passes=0, **settings)
    resumed.go_on_from(begun.sums, 1, 0.0)
    resumed.advance(RAYS)
    assert_contents(join_sums(begun.paths(), resumed.paths()), contents(whole.paths()))


def test_strongest() -> None:
    """The two largest of each group, the larger first; groups without values have none."""
    group = np.array([5, 0, 5, 5, 0, 2])
    values = np.array([1.0, 3.0, 7.0, 4.0, 9.0, 0.5])
    np.testing.assert_array_equal(_strongest(group, values, 2), [4, 1, 5, 2, 3])
    np.testing.assert_array_equal(_strongest(group, values, 1), [4, 5, 2])
    np.testing.assert_array_equal(_strongest(group, values, 10), [4, 1, 5, 2, 3, 0])
    assert len(_strongest(np.zeros(0, dtype=np.int64), np.zeros(0), 3)) == 0
