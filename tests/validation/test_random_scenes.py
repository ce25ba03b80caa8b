"""A thousand random systems (``python tests/random_scenes.py NUMBER FOLDER``): no NaN, closed books, the oracle's
paths; scenes with a fault stay in the test's temporary folder."""

import dataclasses
import faulthandler
import re
import shutil
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import random_scenes
from fuzzing import unclear
from oracles import nonsequential, scene_xml
from random_scenes import NONSENSE, STRUCTURES
from validation.books import faults

import mistray
from mistray.errors import MistrayError
from mistray.recorders.tallies import SAMPLING

pytestmark = pytest.mark.validation

SCENES = 1008  # in all: 28 of each structure
QUICK = {6: 18, 15: 18, 18: 18, 20: 6}  # structure → scenes of it in the quick tests
SOUND = 186  # a scene to be spoilt
BY_ORACLE = 9  # scenes of a structure that the oracle traces, too: of 12 structures a tenth of all
SAMPLING_Z, SAMPLING_SHARE = 8.0, 1e-2
LIMIT_S, STUCK_S = 60, 600  # of the processor; of the clock, after which the process is ended
NUDGE = 1e-5  # by which start rays are moved, in units of the scene's size, to see which paths hang on a rim


def sampling_fault(t: Any) -> list[str]:
    """What was to be scattered less what scattered rays carry is 0 on average; wide limits for rare strong rays."""
    found = []
    for run in t.runs:
        by_batch = run.sums.channels[SAMPLING] / run.rays
        share, spread = float(by_batch.sum()), float(by_batch.std(ddof=1) * np.sqrt(len(by_batch)))
        if abs(share) > max(SAMPLING_Z * spread, SAMPLING_SHARE):
            found.append(f"scattered rays carry too little by {share:.2g} ± {spread:.1g} of the light")
    return found


def against_oracle(t: Any, path: Path) -> list[str]:
    (run,) = t.runs
    model = scene_xml.read_scene(path)
    origin, direction = run.start_rays(np.arange(run.rays))
    size = model.radius_about(model.emitters[0].to_world[:3, 3])
    settings = {key: t.settings[key] for key in ("max_reflections", "max_events", "flux_threshold")}
    power = np.full(run.rays, run.unit)

    def oracle(start: np.ndarray) -> nonsequential.Ledger:
        return nonsequential.trace(model, start, direction, power, run.source.wavelength_nm, **settings)

    theirs = {record.events: record for record in oracle(origin).paths}
    mine = {tuple(row.event_list): row for row in t.paths}
    suspect = set(theirs) ^ set(mine)
    # What R and T may be off by at every surface of the path, their rounding included
    for events in set(theirs) & set(mine):
        a, b = theirs[events], mine[events]
        rtol = len(events) * (2e-5 + 2 * t.coating_error)
        off = max(abs(getattr(a, key) - getattr(b, key)) for key in ("x_mm", "y_mm", "rms_radius_mm"))
        same = a.rays == b.rays and abs(a.power_W - b.power_W) <= rtol * a.power_W and off <= 1e-5 * size
        if not same or a.order != b.order + b.structure_bounces:
            suspect.add(events)
    if not suspect:
        return []
    # A path hangs on a rim, on the critical angle or on many a hit before if it is another one for moved start rays
    across = np.cross(direction, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(direction, across)
    moved = []
    for angle in np.arange(6) * np.pi / 3:
        for step in (0.1 * NUDGE * size, NUDGE * size):
            ledger = oracle(origin + step * (np.cos(angle) * across + np.sin(angle) * up))
            moved.append({record.events: record for record in ledger.paths})
    return [text for events in sorted(suspect) if (text := _unexplained(events, mine, theirs, moved, run.unit))]


def _unexplained(events: Any, mine: Any, theirs: Any, moved: list[Any], unit: float) -> str:
    name = " ".join(f"{place}:{event}" for place, event in events)
    had = set(theirs[events].start_rays.tolist()) if events in theirs else set()
    fragile: set[int] = set()
    for ledger in moved:
        fragile |= had ^ (set(ledger[events].start_rays.tolist()) if events in ledger else set())
    rays = mine[events].rays if events in mine else 0
    if abs(rays - len(had)) > len(fragile):
        return f"{name}: {rays} rays, the oracle has {len(had)}, of which {len(fragile)} hang on a rim"
    if rays == 0 or not had or fragile:
        return ""
    a, b = theirs[events], mine[events]
    for key, least in (("power_W", 1e-3 * a.power_W), ("x_mm", 0.0), ("y_mm", 0.0), ("rms_radius_mm", 0.0)):
        moves = max(abs(getattr(ledger[events], key) - getattr(a, key)) for ledger in moved)
        if abs(getattr(a, key) - getattr(b, key)) > moves + least:
            return f"{name}: {key} {getattr(b, key):.9g}, the oracle has {getattr(a, key):.9g} ± {moves:.1g}"
    return ""


@dataclasses.dataclass
class Outcome:
    traced: int = 0
    lit: int = 0
    wrong: list[str] = dataclasses.field(default_factory=list)


def run(chosen: Iterable[int], folder: Path) -> Outcome:
    outcome = Outcome()
    for number in chosen:
        made = random_scenes.scene(number)
        path = made.write(folder / str(number))
        found: list[str] = []
        faulthandler.dump_traceback_later(STUCK_S, exit=True)
        started = time.process_time()
        try:
            t = mistray.trace(mistray.load(path), **made.settings)
        except MistrayError as error:
            wrong = unclear(str(error))
            found += [wrong] if wrong else []
            if not made.nonsense and not any(word in str(error) for word in REFUSED):
                found.append(f"refused: {error}")
        except Exception as error:
            found.append(f"{type(error).__name__}: {error}")
        else:
            outcome.traced += 1
            outcome.lit += t.energy.detected_W > 0
            found += faults(t) + sampling_fault(t)
            if made.nonsense:
                found.append(f"makes no sense ({made.nonsense}) and is traced")
            elif made.structure.by_oracle and number < BY_ORACLE * STRUCTURES:
                found += against_oracle(t, path)
        finally:
            faulthandler.cancel_dump_traceback_later()
        if time.process_time() - started > LIMIT_S:
            found.append(f"takes {time.process_time() - started:.0f} s")
        if found:
            outcome.wrong.append(f"scene {number}, in {path.parent}: {'; '.join(found)}")
        else:
            shutil.rmtree(path.parent)
    return outcome


# Sound scenes that are refused all the same, each with the reason that is theirs
REFUSED = (
    "no ray of its light",  # drawn so that it passes everything
    "'detector' and 'mirror' cross",  # where there is little room before the mirror
    "is not smooth",  # a roughness beyond the theory
    "more light than",  # models of scatter that add up to more than all of it
)


def check(structure: int, count: int, folder: Path) -> Outcome:
    outcome = run(range(structure, structure + count * STRUCTURES, STRUCTURES), folder)
    assert not outcome.wrong, "\n".join(outcome.wrong)
    assert outcome.traced >= count / 2
    return outcome


@pytest.mark.parametrize("structure", QUICK)
def test_some_random_scenes(structure: int, tmp_path: Path) -> None:
    assert check(structure, QUICK[structure], tmp_path).lit >= QUICK[structure] / 4


@pytest.mark.parametrize("name", NONSENSE)
def test_what_makes_no_sense_is_refused(name: str, tmp_path: Path) -> None:
    made = random_scenes.scene(SOUND)
    NONSENSE[name](made)
    with pytest.raises(MistrayError) as caught:
        mistray.trace(mistray.load(made.write(tmp_path)), **made.settings)
    assert unclear(str(caught.value)) is None


def test_faults_are_noticed(tmp_path: Path) -> None:
    made = random_scenes.scene(SOUND)
    assert not made.nonsense
    path = made.write(tmp_path)
    t = mistray.trace(mistray.load(path), **made.settings)
    assert t.energy.detected_W > 0
    assert faults(t) + sampling_fault(t) + against_oracle(t, path) == []
    energy = t.energy
    for change in ({"escaped_W": np.nan}, {"escaped_W": -1e-9}, {"detected_W": energy.detected_W * (1 - 1e-3)}):
        t.energy = dataclasses.replace(energy, **change)
        assert faults(t)
    t.energy = energy

    bend = re.search(r'id="L0_0">.*?name="curvature" value="([^"]*)"', made.text)
    assert bend
    made.text = made.text.replace(bend[1], repr(1.001 * float(bend[1])))
    assert against_oracle(t, made.write(tmp_path / "bent"))


@pytest.mark.slow
@pytest.mark.parametrize("structure", range(STRUCTURES))
def test_random_scenes(structure: int, tmp_path: Path) -> None:
    outcome = check(structure, SCENES // STRUCTURES, tmp_path)
    assert outcome.lit > 0 or random_scenes.structure(structure).settings.get("max_events") == 1
