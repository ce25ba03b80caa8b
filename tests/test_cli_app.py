"""`mistray app`: the address is printed, the page answers, and Ctrl-C ends it as it should."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import json_units
import pytest
from command_line import Captured, fails, run

SCENE = "singlet_window_detector"
QUICK = ("app", SCENE, "--rays", "500", "--no-browser", "--field-deg", "0")


def test_the_address_is_printed(capsys: Captured, tmp_path: Path) -> None:
    code, out, err = run(capsys, *QUICK, "--seconds", "1", "--json")
    assert code == 0
    # With kernels in no cache one line says what their compilation took
    assert all("compilation" in line for line in err.splitlines())
    found = json_units.read(out)
    assert found["address"].startswith(f"http://127.0.0.1:{found['port']}/")
    (tmp_path / "explored_scene.xml").write_text("mine")
    assert "explored_scene.xml" in fails(capsys, *QUICK, "--seconds", "1", "--out", tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(number: signal.Signals) -> None:
    command = [sys.executable, "-m", "mistray", *QUICK, "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    try:
        text = ""
        while not text.rstrip().endswith("}"):
            text += process.stdout.readline()
        address = json.loads(text)["address"]
        with urllib.request.urlopen(address, timeout=20) as reply:
            assert reply.status == 200
        time.sleep(1.0)
        process.send_signal(number)
        _, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 0
    assert err == ""
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address, timeout=5)
