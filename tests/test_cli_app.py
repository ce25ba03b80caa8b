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

import json_units
import pytest

from mistray import cli

SCENE = "singlet_window_detector"
QUICK = ("--rays", "500", "--no-browser", "--field-deg", "0")


def test_the_address_is_printed(capsys):
    assert cli.main(["app", SCENE, *QUICK, "--seconds", "1", "--json"]) == 0
    out, err = capsys.readouterr()
    # With kernels in no cache one line says what their compilation took
    assert all("compilation" in line for line in err.splitlines())
    found = json_units.read(out)
    assert found["address"].startswith(f"http://127.0.0.1:{found['port']}/")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--control", "nothing"), "nothing"),
        (("--port", "0"), "port"),
        (("--port", "70000"), "70000"),
        (("--field-deg", "90"), "90"),
        (("--wavelength-nm", "1e308"), "1e308"),
        (("--seconds", "-1"), "-1"),
    ],
)
def test_wrong_input_is_one_line(capsys, options, said):
    assert cli.main(["app", SCENE, "--no-browser", "--seconds", "1", *options]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


def test_files_that_are_there_are_not_replaced(capsys, tmp_path):
    (tmp_path / "explored_scene.xml").write_text("mine")
    assert cli.main(["app", SCENE, *QUICK, "--seconds", "1", "--out", str(tmp_path)]) == 2
    assert "explored_scene.xml" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(number):
    command = [sys.executable, "-m", "mistray", "app", SCENE, *QUICK, "--json"]
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
