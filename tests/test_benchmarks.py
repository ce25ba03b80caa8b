"""The benchmarks: that they refuse unequal work, remember, and tell what got slower. They run in small here."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mistray.errors import MistrayError

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "benchmarks"


@pytest.fixture(autouse=True)
def _folder(monkeypatch):
    """Modules of the benchmarks, found by their names as when they are run; none stays behind."""
    monkeypatch.syspath_prepend(str(FOLDER))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(FOLDER)):
            del sys.modules[name]


def row(ratio, **more):
    from rows import Row

    return Row(**{"key": "a", "what": "this", "ours": "1 s", "other": "2 s", "ratio": ratio, **more})


def run(*arguments, program="bench.py", code=0):
    command = [sys.executable, str(FOLDER / program), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout, done.stderr


def test_work_that_differs_gives_no_ratio():
    from rows import NotTheSameWorkError, agree, measured

    assert agree("flux", 1.0009, 1.0, 1e-3) == "flux to 0.0009"
    assert agree("R", [0.1, 0.2], [0.1, 0.2], 0.0) == "R to 0"
    for ours, other in ((1.002, 1.0), (math.nan, 1.0), (1.0, 0.0), ([0.1, 0.3], [0.1, 0.2])):
        with pytest.raises(NotTheSameWorkError, match="no ratio is given"):
            agree("flux", ours, other, 1e-3)
    refused = measured("lsst", "ghosts", lambda: row(7.0, equal=agree("flux", 2.0, 1.0, 1e-3)))
    assert refused.failed
    assert math.isnan(refused.ratio)
    assert "flux 2 here and 1 there" in refused.other


def test_clock_alternates_and_exponents_and_verdicts_and_what_got_worse():
    from rows import alternate, slope

    turns = []
    pair = alternate(lambda: turns.append("a"), lambda: turns.append("b"), repeats=3)
    assert turns == ["a", "b"] * 4  # once before the clock starts
    assert all(0 < one.seconds < 1 for one in pair)
    x = np.array([10, 20, 40, 80])
    assert slope(x, 3e-9 * x**2) == pytest.approx(2, abs=1e-12)
    from record import worse

    for ratio, bar, small, verdict in (
        (10.0, 10.0, False, "≥ 10 reached"), (9.99, 10.0, False, "≥ 10 NOT REACHED"),
        (1.05, 1.05, True, "≤ 1.05 reached"), (1.06, 1.05, True, "≤ 1.05 NOT REACHED"), (math.nan, 10.0, False, ""),
    ):  # fmt: skip
        assert row(ratio, bar=bar, small=small).verdict == verdict
    for before, now, small, slower in (
        (10.0, 8.8, False, False), (10.0, 8.0, False, True), (2.0, 2.25, True, False), (2.0, 2.5, True, True),
        (math.nan, 1.0, False, False), (10.0, math.nan, False, False),
    ):  # fmt: skip
        expected = f"SLOWER by 25 % than the kept run: this: {before:.3g} → {now:.3g}"
        assert worse(row(now, small=small), row(before, small=small)) == (expected if slower else "")


def test_record_keeps_what_was_not_run_again(tmp_path):
    """Of a part that was not run, and of a program that is not installed today; a row that is no more goes."""
    from record import Kept, merged, read, write

    def kept(part, key, ratio, day="2026-01-01"):
        return Kept(part, row(ratio, key=key, bar=2.0, series={"x": [1.0, 2.0]}), day, "a machine")

    path = tmp_path / "last.json"
    assert read(path) == {}
    old = {k.name: k for k in (kept("batoid", "lsst", 5.0), kept("films", "tmm", 7.0), kept("films", "gone", 1.0))}
    write(path, old)
    found = read(path)
    assert found == old
    new = merged(found, ["films"], [kept("films", "tmm", math.nan, "2026-02-02"), kept("films", "mie", 3.0)])
    ratios = {name: one.row.ratio for name, one in new.items()}
    assert ratios == {"batoid/lsst": 5.0, "films/tmm": 7.0, "films/mie": 3.0}
    assert {one.day for one in new.values()} == {"2026-01-01"}
    write(path, {"a/b": kept("a", "b", math.nan)})
    assert json.loads(path.read_text())["rows"][0]["ratio"] is None
    assert math.isnan(read(path)["a/b"].row.ratio)
    path.write_text('{"format": 9, "rows": []}')
    with pytest.raises(MistrayError, match=r"last\.json: no record of benchmarks \(format 9\)"):
        read(path)


def test_missing_program_has_a_row(monkeypatch):
    import telescopes

    monkeypatch.setattr("rows.find_spec", lambda name: None)
    found = list(telescopes.rows(True))
    assert [one.key for one in found] == ["lsst", "hsc", "decam", "rubin"]
    for one in found:
        assert one.other == "not measured: batoid not installed (pip install batoid)"
        assert (math.isnan(one.ratio), one.failed) == (True, False)


def test_other_sizes_are_not_the_same_work(monkeypatch):
    """Spheres and films that are 0.1 % larger on one side: no ratio may come out."""
    pytest.importorskip("miepython")
    pytest.importorskip("tmm")
    import spheres
    import thinfilm
    from rows import NotTheSameWorkError

    same = spheres.spheres
    monkeypatch.setattr(spheres, "spheres", lambda x, m, a: same(1.001 * x, m, a))
    (one,) = spheres.rows(True)
    assert one.failed
    assert "extinction" in one.other
    grid = thinfilm.Grid.of(4, 2)
    theirs = thinfilm.in_tmm(grid)
    monkeypatch.setattr(thinfilm, "D_NM", 1.001 * thinfilm.D_NM)
    with pytest.raises(NotTheSameWorkError, match="not the same work: R "):
        thinfilm.against_peer("tmm", grid, grid, [theirs], 1)


def test_ghosts_of_another_reflectance_are_not_the_same_work(monkeypatch):
    pytest.importorskip("batoid")
    import telescopes
    from rows import NotTheSameWorkError

    telescope = telescopes.TELESCOPES[0]
    trace = telescopes.ours(telescope, telescopes.scene_of(telescope), 300)
    assert telescopes.same_ghosts(trace, telescopes.theirs(telescope, trace)()).startswith("34 ghosts, flux to ")
    monkeypatch.setattr(telescopes, "REFLECTANCE", 0.0202)
    brighter = telescopes.theirs(telescope, trace)()
    with pytest.raises(NotTheSameWorkError, match="flux"):
        telescopes.same_ghosts(trace, brighter)


def test_run_keeps_compares_and_is_strict(tmp_path, monkeypatch, capsys):
    import bench
    import spheres

    def measure(ratio, *options, more=()):
        monkeypatch.setattr(spheres, "rows", lambda quick: iter([row(ratio, bar=5.0), *more]))
        return bench.main(["--only", "mie", "--folder", str(tmp_path), *options]), capsys.readouterr().out

    def kept():
        return [entry["ratio"] for entry in json.loads((tmp_path / "last.json").read_text())["rows"]]

    assert "≥ 5 reached" in measure(10.0)[1]
    assert kept() == [10.0]
    assert "≥ 5 reached" in (tmp_path / "README.md").read_text()
    for ratio, options, expected, slower in (
        (4.0, ("--strict",), (1, [10.0]), True),
        (9.0, ("--strict", "--no-write"), (0, [10.0]), False),
        (4.0, ("--quick",), (0, [10.0]), False),
        (4.0, (), (0, [4.0]), True),
    ):
        code, table = measure(ratio, *options)
        assert (code, kept()) == expected
        assert ("SLOWER by 150 % than the kept run: this: 10 → 4" in table) is slower
    code, table = measure(4.0, more=[row(math.nan, key="b", other="not the same work", failed=True)])
    assert code == 1
    assert "mie/b: not the same work" in table
    monkeypatch.setattr(spheres, "rows", lambda quick: 1 / 0)
    assert bench.main(["--only", "mie", "--folder", str(tmp_path)]) == 1
    assert "FAILED: ZeroDivisionError: division by zero" in capsys.readouterr().out


def test_page_shows_every_row_and_what_each_side_computes(tmp_path):
    """With the figure, the days and machines, and of every comparison with another program the precision."""
    from bench import PARTS
    from page import write_page
    from record import Kept

    more = {"growth": {"series": {"rays": [1e4, 1e5], "seconds": [1.0, 9.0]}}}
    kept = {part: Kept(part, row(2.0, **more.get(part, {})), "2026-01-01", "machine A") for part in PARTS}
    kept["memory"] = Kept("memory", row(3.0), "2026-01-02", "machine B")
    write_page(tmp_path / "README.md", tmp_path / "growth.svg", kept, PARTS)
    text = (tmp_path / "README.md").read_text()
    assert all(str(one.row) in text for one in kept.values())
    assert "- 2026-01-02, machine B: memory\n- 2026-01-01, machine A: " in text
    assert "(growth.svg)" in text
    assert (tmp_path / "growth.svg").read_text().lstrip().startswith("<?xml")
    sections = text.split("\n## ")[1:]
    assert len(sections) == len(PARTS)
    for part, section in zip(PARTS, sections, strict=True):
        assert (FOLDER / f"{PARTS[part][0]}.py").exists()
        if part in ("embree", "batoid", "optiland", "films", "mie"):
            assert "float" in section or "complex128" in section


@pytest.mark.slow
@pytest.mark.parametrize(
    "part", ["embree", "batoid", "optiland", "films", "mie", "modes", "gradients", "memory", "growth"]
)
def test_every_part_runs_in_small(part, tmp_path):
    table, _ = run("--quick", "--only", part, "--folder", tmp_path)
    assert not list(tmp_path.iterdir())
    assert "FAILED" not in table
    assert "not the same work" not in table


def test_numbers_that_changed_are_named(tmp_path):
    """The same program gives the same numbers; another number, a path more or other kernels are told apart."""
    from same_numbers import differences

    first, second = tmp_path / "first.json", tmp_path / "second.json"
    scene = ("--scenes", "plate_and_wall")
    run(first, *scene, program="same_numbers.py")
    run(second, *scene, "--against", first, program="same_numbers.py")
    before = json.loads(first.read_text())
    trace = before["trace plate_and_wall"]
    assert trace["kernels"]
    trace["numbers"]["detected"][0] *= 1.001
    first.write_text(json.dumps(before))
    told, _ = run(second, *scene, "--against", first, program="same_numbers.py", code=1)
    assert "detected" in told.splitlines()[0]
    path, (power, se) = next(iter(trace["paths"].items()))

    def changed(**values):
        return list(differences(before, {**before, "trace plate_and_wall": {**trace, **values}}))

    other = {**trace["paths"], path: (power * (1 + 1e-9), se)}
    assert len(changed(paths=other)) == 1
    assert not changed(paths=other, kernels=["another"])
    assert len(changed(paths={**other, path: (power + max(4.3 * se, 2e-5 * power), se)}, kernels=["another"])) == 1
    assert len(changed(paths={**trace["paths"], "strong": (1e-5 * trace["launched_W"], 0.0)}, kernels=["x"])) == 1
    assert not changed(paths={**trace["paths"], "faint": (1e-7 * trace["launched_W"], 0.0)}, kernels=["x"])


@pytest.mark.quick
def test_same_numbers_uses_every_kind_of_plugin():
    from same_numbers import TRACES

    def kinds(names):
        files = [ROOT / "scenes" / name / "scene.xml" for name in names]
        return {kind for file in files for kind in re.findall('type="([a-z_]+)"', file.read_text())}

    assert kinds(TRACES) == kinds(folder.parent.name for folder in (ROOT / "scenes").glob("*/scene.xml"))
    assert len(TRACES) == 12


@pytest.mark.quick
def test_same_outputs_uses_every_option_of_every_command(monkeypatch):
    import same_outputs

    from mistray.cli.program import COMMANDS

    assert set(same_outputs.CALLS) == {module.COMMAND.name for module in COMMANDS}
    assert same_outputs.unused_options() == []
    monkeypatch.setitem(same_outputs.CALLS, "completion", ())
    assert same_outputs.unused_options() == ["completion shell"]


@pytest.mark.quick
@pytest.mark.parametrize(
    ("before", "after", "exact", "places"),
    [
        ({"R": 0.5}, {"R": 0.5 + 1e-10}, True, []),
        ({"R": 0.5}, {"R": 0.500001}, True, ["R"]),
        ({"R": 0.5}, {"R": 0.500001}, False, []),
        ({"power_W": 1.0, "power_se_W": 0.1}, {"power_W": 1.3, "power_se_W": 0.12}, False, []),
        ({"power_W": 1.0, "power_se_W": 0.1}, {"power_W": 1.6, "power_se_W": 0.1}, False, ["power_W"]),
        ({"value": [1.0, 2.0], "se": [0.1, 0.0]}, {"value": [1.2, 2.1], "se": [0.1, 0.0]}, False, ["value[1]"]),
        ({"power_W": [1.0]}, {"flux_W": [1.0]}, True, ["power_W", "flux_W"]),
        ({"rays": 5, "seed": 1}, {"seed": 1, "rays": 5}, True, [": order"]),
        ("ghost 1.00 ± 0.10 W", "ghost 1.20 ± 0.11 W", False, []),
        ("ghost 1.00 ± 0.10 W", "ghost 1.80 ± 0.11 W", False, ["text"]),
        ("ghost 1.00 ± 0.10 W", "ghosts 1.00 ± 0.10 W", False, ["text"]),
        ("L1_front 1", "L2_front 1", False, ["text"]),
        ("a\nb 1\nc", "a\nb 2\nc\nd", True, ["text line 2", "text line 4"]),
        ([1, 2], [1, 2, 3], True, ["text"]),
    ],
)
def test_outputs_are_the_same_but_for_their_errors(before, after, exact, places):
    from output_differences import unlike

    assert [place for place, _, _ in unlike(before, after, exact, "" if isinstance(before, dict) else "text")] == places


@pytest.mark.long
def test_outputs_that_changed_are_named(tmp_path):
    """The same program prints the same; a changed default and a renamed column are told."""
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    run(first, "--commands", "coating", program="same_outputs.py")
    same = run(second, "--commands", "coating", "--against", first, program="same_outputs.py")[0]
    assert re.fullmatch(r"0 of \d+ calls differ\n", same)
    before = json.loads(first.read_text())
    design = before["options"]["coating"]["options"]["--design-nm"]
    assert "(550)" in design["help"]
    design["help"] = design["help"].replace("(550)", "(500)")
    wrote = (call["files"] for name, call in before["calls"].items() if "--csv ar.csv" in name and call["files"])
    table = next(wrote)["ar.csv"]
    table["columns"]["reflectance"] = table["columns"].pop(table["head"][-1])
    first.write_text(json.dumps(before))
    told, _ = run(second, "--commands", "coating", "--against", first, program="same_outputs.py", code=1)
    assert re.search(r"coating: options\.--design-nm\.help: .*\(500\).* → .*\(550\)", told)
    assert "ar.csv.columns.reflectance: " in told
    assert re.search(r"\n2 of \d+ calls differ\n$", told)


def test_operations_of_a_kernel_are_counted():
    """Blocks apart; operands that are not of the block are loads, once each, and float64 takes two packets."""
    from roofline import Operations, operations

    code = """
entry:
    %f1 = load <16 x float>, ptr %f1_p3, align 64
    %f2_1 = insertelement <16 x float> undef, float 0x3ff0, i32 0
    %f2 = shufflevector <16 x float> %f2_1, <16 x float> undef, <16 x i32> zeroinitializer
    %f3 = fadd <16 x float> %f1, %f2
    br i1 %u4_t, label %l_4_t, label %l_4_next
l_4_t:
    %f5 = fdiv <16 x float> %f3, %f2
    %f6 = call <16 x float> @llvm.sqrt.v16f32(<16 x float> %f5)
    %d7 = fmul <16 x double> %d6, %d6
    br label %l_4_t_trailer
l_4_t_trailer:
    store <16 x float> %f3, ptr %f8_p3, align 64
"""
    first, block = operations(code)
    assert first == Operations(arithmetic=1, loads=2, stores=1)
    assert block == Operations(arithmetic=2, divisions=1, roots=1, loads=3)
    assert first.bound == 1.0
    assert block.bound == 35.0
    assert (0.5 * block + first).total == 3.0


@pytest.mark.slow
def test_the_roofline_runs():
    table, _ = run("plate", program="roofline.py")
    assert [line.split("|")[1].strip() for line in table.splitlines() if line.startswith("| ")][-1] == "all"
