"""The explorer used in a real browser: ten steps of somebody who plays with a lens, and twenty moves that are timed."""

import json
import random
import threading
import time
from contextlib import contextmanager
from statistics import median

import pytest
import vectors
from analyses.explorer.chromium import needs_chromium, page

from mistray.analyses.explorer.explorer import Explorer
from mistray.analyses.explorer.saving import SCENE_FILE, STUDY_FILE
from mistray.analyses.explorer.server import serving

pytestmark = [pytest.mark.long, needs_chromium]
ROOT = "document.querySelector('.mistray-explorer')"
# Turns a control and comes back when the page has been drawn anew: milliseconds
TURN = vectors.text("browser_turn.js")
BARS_S = 0.1, 5.0  # from the slider to the page, and to the trace; twice that where another test runs beside this one


@contextmanager
def served(explorer, folder):
    """A page that shows an explorer, which works in a thread of its own."""
    ended = threading.Event()

    def work():
        while not ended.is_set():
            explorer.work(0.1)

    worker = threading.Thread(target=work)
    worker.start()
    try:
        with serving(explorer) as server, page(folder / "profile") as found:
            found.open(server.address)
            found.until(f"{ROOT}?.dataset.label === 'traced'")
            yield found
    finally:
        ended.set()
        worker.join()


def turn(shown, name, value):
    return shown.run(TURN % (json.dumps(name), json.dumps(str(value))))


def numbers(shown):
    return shown.run("[...document.querySelectorAll('.numbers dd')].map((item) => item.textContent)")


def click(shown, selector, text=""):
    found = f"[...document.querySelectorAll({json.dumps(selector)})]"
    shown.run(f"{found}.find((item) => item.textContent.includes({json.dumps(text)})).click()")


def until_traced(shown):
    return shown.until(f"{ROOT}.dataset.label === 'traced' && !{ROOT}.dataset.busy.includes('trac')")


def test_ten_steps(tmp_path):
    explorer = Explorer("singlet_window_detector", field_deg=[0.0, 2.0], rays=2000, max_reflections=2)
    explorer.saving.folder = tmp_path
    with served(explorer, tmp_path) as shown:
        bare = numbers(shown)  # 1: the scene as it is
        assert shown.run("document.querySelectorAll('table.paths tbody tr').length") > 5
        turn(shown, "coating window", "bbar3")  # 2: coat the window
        assert shown.run(f"{ROOT}.dataset.label") == "estimate"
        estimate = numbers(shown)
        assert estimate[0] != bare[0]
        until_traced(shown)  # 3: the trace comes by itself, and says how far the estimate was off
        told = shown.run("document.querySelector('.difference').textContent")
        assert "% from the trace, " in told
        assert numbers(shown)[0].partition(" W")[0] in told  # the same number with the same digits
        assert float(numbers(shown)[0].split()[0]) == pytest.approx(float(estimate[0].split()[0]), rel=0.01)
        click(shown, "table.paths td button", "detector → window_rear")  # 4: a path
        shown.until("document.querySelector('svg.rays .ray')")
        assert "detector" in shown.run("document.querySelector('.turns').textContent")
        pressed = "document.querySelector('table.paths button[aria-pressed=\"true\"]').textContent"
        assert shown.run(pressed) == "detector → window_rear"
        told = shown.run("document.querySelector('.detail').textContent")
        turn(shown, "detector.bsdf.R", 300)  # 5: a number
        assert shown.run(f"{ROOT}.dataset.label") == "estimate"
        assert explorer.state["detector.bsdf.R"] < 0.1
        until_traced(shown)  # what is told of the path is of the new trace
        shown.until(f"document.querySelector('.detail').textContent !== {json.dumps(told)}")
        turn(shown, "field", 500)  # 6: the field
        assert shown.run("document.querySelector('.left-out').textContent").startswith("field")
        until_traced(shown)
        assert shown.run("document.querySelector('.left-out').textContent") == ""
        turn(shown, "layers", 400)  # 7: thicker layers, and the wavelength
        turn(shown, "wavelength", 600)
        assert "stay as they were" in shown.run("document.querySelector('.left-out').textContent")
        until_traced(shown)
        click(shown, "table.paths td button", "L1_rear")  # 8: what would weaken a path of the lens, put on
        shown.until("document.querySelector('.turns').textContent.includes('L1_rear')")
        before = numbers(shown)[0]
        click(shown, ".remedies button")
        shown.until(f"document.querySelector('.numbers dd').textContent !== {json.dumps(before)}")
        assert explorer.state["coating L1"] != "as it is"
        for button, file in (("Save scene", SCENE_FILE), ("Save study", STUDY_FILE)):  # 9: save both
            click(shown, ".buttons button", button)
            shown.until(f"document.querySelector('.said').textContent.includes({json.dumps(str(tmp_path / file))})")
            assert (tmp_path / file).is_file()
        until_traced(shown)  # lest this trace end between the click and its answer
        click(shown, ".buttons button", "Reset")  # 10: all as it was
        shown.until(f"document.querySelector('.numbers dd').textContent !== {json.dumps(numbers(shown)[0])}")
        until_traced(shown)
        assert numbers(shown) == bare
        for scheme in ("light", "dark"):
            shown.like(scheme)
            assert shown.violations() == []
            assert shown.is_white() == (scheme == "light")
        shown.open(shown.run("location.href"), 390, 844)  # and on a telephone
        shown.until("document.querySelector('table.paths tbody tr')")
        assert shown.run("document.documentElement.scrollWidth") <= 390
        assert shown.errors == []
    assert explorer.view()["message"] == ""


def test_twenty_moves(tmp_path):
    """Prints the table of docs/app.md: ``python -m pytest -s tests/analyses/explorer/test_browser.py -k twenty``."""
    explorer = Explorer("phone_camera", field_deg=[10.0, 0.0, 5.0, 15.0, 20.0])
    explorer.prepare()
    chance, rows = random.Random(22), []
    with served(explorer, tmp_path) as shown:
        for _ in range(20):
            shown.until(f"{ROOT}.dataset.label === 'traced' && !{ROOT}.dataset.busy", 120)
            control = chance.choice(list(explorer.controls.values()))
            others = [choice for choice in control.choices if choice != explorer.state[control.name]]
            place = chance.choice(others) if others else chance.randrange(1001)
            began = time.monotonic()
            to_page = turn(shown, control.name, place)
            shown.until(f"{ROOT}.dataset.label === 'traced'", 60)
            took = time.monotonic() - began
            value = explorer.state[control.name]
            said = value if isinstance(value, str) else f"{value:.4g} {control.unit}".strip()
            rows.append((f"{control.label} {said}", to_page, took, explorer.view()["difference"]))
        assert shown.errors == []
    print("\n\n| move | page [ms] | traced [s] | estimate [W] | traced [W] | off |\n|---|---|---|---|---|---|")
    for name, to_page, took, d in rows:
        print(f"| {name} | {to_page:.0f} | {took:.1f} | {d['estimate_W']:.5g} | {d['traced_W']:.5g} ± "
              f"{d['traced_se_W']:.1g} | {d['percent']:+.2f} % |")  # fmt: skip
    assert median(row[1] for row in rows) < 2e3 * BARS_S[0]
    assert max(row[2] for row in rows) < 2 * BARS_S[1]
