"""Parts whose cases are processes of their own: killed, interrupted, in strange surroundings, asked too much."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import urlsplit

from attack.parts import GUTS, Case

MISTRAY = [sys.executable, "-m", "mistray"]
RUNS = {
    "ghosts": ["ghosts", "plate", "--rays", "500", "--field-deg", "0", "2"],
    "pst": ["pst", "plate", "--rays", "2000", "--no-next-order", "--field-deg", "0", "20"],
    "sweep": ["sweep", "plate", "--rays", "500", "--field-deg", "0", "2", "--no-cache"],
}
LIST = re.compile(rb"<!-- files of this report: (.*?) -->", re.DOTALL)
SLACK_S = 2.0
# Kills itself at the N-th call of the system that makes, names, links or removes something
KILLER = """
import os, signal, sys
count, last = 0, int(sys.argv.pop(1))
def hook(name, _):
    global count
    if name in ("os.rename", "os.link", "os.remove", "os.mkdir", "shutil.rmtree") and started:
        count += 1
        if count == last:
            os.kill(os.getpid(), signal.SIGKILL)
started = False
sys.addaudithook(hook)
from mistray import replace_folder, cli
before = replace_folder._replace
def replace(*given):
    global started
    started = True
    before(*given)
replace_folder._replace = replace
sys.exit(cli.main())
"""


def _mixed(out: Path) -> str:
    """What is wrong with a folder: files that are not those of its page, and no mark of it."""
    page = out / "report.html"
    if not page.exists() or (out / "incomplete").exists():
        return ""
    lists = LIST.findall(page.read_bytes())
    if not lists:
        return "the page has no list"
    for name, wanted in json.loads(lists[-1]).items():
        if not (out / name).exists() or hashlib.sha256((out / name).read_bytes()).hexdigest() != wanted:
            return f"{name} is not that of the page"
    return ""


def kills(folder: Path, seed: int) -> list[Case]:
    """Runs that are killed at a random time: the folder is whole."""
    rng = random.Random(seed)

    def case(number: int, name: str, delay: float) -> Case:
        def run() -> str:
            words = [*MISTRAY, *RUNS[name], "--quiet", "--force", "--out", str(folder / name)]
            process = subprocess.Popen(words, cwd=folder, stderr=subprocess.DEVNULL)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(delay)
            process.kill()
            process.wait()
            return _mixed(folder / name)

        return Case(f"{number} {name} after {delay:.2f} s", run)

    return [case(k, name, rng.uniform(1, 8)) for k, name in enumerate(["ghosts"] * 20 + ["pst"] * 14 + ["sweep"] * 14)]


def renames(folder: Path, seed: int) -> list[Case]:
    """Runs that are killed at each step in which files are put in their place, in a folder and in the current one."""

    def case(number: int, here: bool) -> Case:
        def run() -> str:
            out = folder / ("here" if here else "out")
            out.mkdir(exist_ok=True)
            target = "." if here else str(out)
            words = [*RUNS["sweep"], "--quiet", "--force", "--out", target]
            done = subprocess.run([sys.executable, "-c", KILLER, str(number), *words], cwd=out if here else folder)
            if done.returncode not in (0, -signal.SIGKILL):
                return f"exit code {done.returncode}"
            return _mixed(out)

        return Case(f"{number} in {'the current folder' if here else 'a folder'}", run)

    return [case(number, here) for here in (False, True) for number in range(1, 21)]


COMMANDS = {
    "ghosts": ["plate", "--rays", "4e9"], "pst": ["plate", "--rays", "4e9"], "objects": ["plate", "--rays", "4e9"],
    "sweep": ["plate", "--rays", "4e9", "--no-cache"], "thermal": ["plate", "--rays", "4e9"],
    "study": ["plate", "--rays", "4e9"], "sensitivity": ["plate", "--rays", "4e9"], "image": ["rubin", "--grid", "900"],
    "optimize": ["plate", "study.toml", "--steps", "1000"],
    "view": ["phone_camera", "--rays", "4e9", "--out", "v.html"],
    "app": ["plate", "--no-browser"], "ghosts scatter": ["phone_camera_scatter", "--rays", "4e9"],
    "pst scatter": ["phone_camera_scatter", "--rays", "4e9"], "ghosts triplet": ["cooke_triplet", "--rays", "4e9"],
    "ghosts rubin": ["rubin", "--rays", "4e9"], "ghosts fields": ["plate", "--rays", "4e9", "--field-deg", "0:10:1"],
    "pst tube": ["baffle_tube", "--rays", "4e9"],
}  # fmt: skip


def _queued(process: subprocess.Popen[str]) -> dict[str, float]:
    """Seconds that each thread has been ready to run while other processes had the processor."""
    found = {}
    for path in Path(f"/proc/{process.pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError, IndexError):
            found[path.parent.name] = int(path.read_text().split()[1]) / 1e9
    return found


def _interrupt(folder: Path, name: str, number: int, delay: float) -> Callable[[], str]:
    def run() -> str:
        words = [*MISTRAY, name.split()[0], *COMMANDS[name]]
        process = subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        status = Path(f"/proc/{process.pid}/status")
        while process.poll() is None and "SigBlk:\t0000000000000000" in status.read_text():
            time.sleep(0.001)  # until mistray holds signals back, which is the first that it does
        time.sleep(delay)
        if process.poll() is not None:
            process.communicate()
            return ""
        began, before, queued = time.monotonic(), _queued(process), 0.0
        process.send_signal(number)
        while process.returncode is None:
            try:
                _, err = process.communicate(timeout=0.05)
            except subprocess.TimeoutExpired:
                queued = max([queued, *(now - before.get(thread, 0.0) for thread, now in _queued(process).items())])
                if time.monotonic() - began - queued > 30.0:
                    process.kill()
                    process.communicate()
                    return "it ran on for 30 s"
        took, code = time.monotonic() - began - queued, process.returncode
        code = 128 - code if code < 0 else code
        if code not in (0, 128 + signal.SIGINT, 128 + number):
            return f"exit code {code}: {err[-200:]}"
        if "Traceback" in err or GUTS.search(err):
            return f"a traceback: {err[-200:]}"
        return f"it took {took:.1f} s" if took > SLACK_S else ""

    return run


def interrupts(folder: Path, seed: int) -> list[Case]:
    """Ctrl-C or SIGTERM at a random time, four times for each of 17 commands."""
    rng = random.Random(seed)
    cases = []
    for name in COMMANDS:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT, signal.SIGTERM):
            delay = rng.uniform(1.0, 9.0)
            cases.append(Case(f"{name}, {number.name} after {delay:.1f} s", _interrupt(folder, name, number, delay)))
    return cases


def first_second(folder: Path, seed: int) -> list[Case]:
    """Ctrl-C while mistray is imported; what comes before its own first line is left to Python."""
    return [
        Case(f"after {delay:.2f} s", _interrupt(folder, "ghosts", signal.SIGINT, delay))
        for delay in (0.05 * k for k in range(20))
    ]


def surroundings(folder: Path, seed: int) -> list[Case]:
    """Locales, homes, streams, terminals, folders and limits."""
    run, small = " ".join(MISTRAY), "ghosts plate --rays 50 --json"
    sets = {f"{name}={value!r}": f"{name}='{value}' {run} {small}" for name in ("LC_ALL", "PYTHONIOENCODING", "TERM",
            "COLUMNS", "TZ", "MPLBACKEND", "MPLCONFIGDIR", "XDG_CACHE_HOME", "TMPDIR", "MISTRAY_CACHE")
            for value in {"COLUMNS": ("0", "-1", "x"), "PYTHONIOENCODING": ("ascii", "latin-1", "utf-16"),
                          "MPLBACKEND": ("", "nonsense", "agg")}.get(name, ("", "C", "/proc/nobody"))}  # fmt: skip
    streams = ("2>&-", ">&-", "<&-", ">&- 2>&-", "<&- >&- 2>&-", "> /dev/full", "| head -c 1", "2> /dev/full")
    sets |= {stream: f"{run} {small} {stream}" for stream in streams}
    sets |= {
        "no HOME": f"env -u HOME {run} {small}",
        "a deleted folder": f"mkdir gone; cd gone; rmdir ../gone; {run} {small}",
        "--out ''": f'{run} {small} --out ""',
        "few files": f"ulimit -n 20; {run} {small}",
        "no core": f"ulimit -c 0; {run} {small}",
        "small files": f"ulimit -f 8; {run} {small} --out small",
        "a folder to read": f"mkdir -p r; chmod 555 r; cd r; {run} {small}",
    }
    return [Case(name, _surroundings_case(folder, command)) for name, command in sets.items()][:45]


def _surroundings_case(folder: Path, command: str) -> Callable[[], str]:
    # Python itself ends where it is relative and the folder is deleted
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def run() -> str:
        before = {path.name for path in folder.iterdir()}
        try:
            done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, timeout=300, env=env)
        except subprocess.TimeoutExpired:
            return "no end within 300 s"
        err = done.stderr.decode(errors="replace")
        new = {path.name for path in folder.iterdir()} - before - {"r", "small", "C"}
        if done.returncode not in (0, 2):
            return f"exit code {done.returncode}: {err[-200:]}"
        if GUTS.search(err) or "Fatal" in err:
            return f"the inside of a program: {err[-200:]}"
        if (
            done.returncode == 0
            and "-" not in command.split("json")[-1]
            and not re.search("[|>]", command)
            and not done.stdout
        ):
            return "nothing on stdout"
        return f"it left {sorted(new)}" if new else ""

    return run


def requests(folder: Path, seed: int) -> list[Case]:
    """Requests to the page of the explorer: answered in one line, and only those that know the token with 200."""
    server = subprocess.Popen(
        [*MISTRAY, "app", "plate", "--rays", "50", "--no-browser"], cwd=folder, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    address = ""
    while not address and (line := server.stdout.readline()):
        found = re.search(r"http://\S+", line)
        address = found[0] if found else ""
    url = urlsplit(address)
    token, host = url.path.strip("/"), url.netloc
    cases = []
    types = ("application/json", "text/plain", "")
    for method in ("GET", "POST", "PUT", "OPTIONS", "G" * 5000):
        for path in ("/", f"/{token}/", f"/{token}x/", "/" + "a" * 5000, f"/{token}/../x", "*", f"/{token}/call"):
            for name in (host, "evil.example", "", f"{host}\r\nHost: evil.example"):
                cases.append((method, path, name, types[0], "2", "{}"))
    for length in ("9" * 5000, "-1", "", "x", "1e3", "0", "99999999", "٣", "2, 2"):
        for kind in types:
            cases.append(("POST", f"/{token}/call", host, kind, length, "{}"))
    for body in ("", "[]", "null", "[" * 5000, '{"call": 1}', "{" * 5000, '{"call": "eval"}', "\0", "9" * 5000, "NaN"):
        for extra in (
            "",
            "\r\nOrigin: http://evil.example",
            "\r\nOrigin: null",
            "\r\nTransfer-Encoding: chunked",
            "\r\nContent-Length: 1",
        ):
            cases.append(("POST", f"/{token}/call", f"{host}{extra}", types[0], str(len(body)), body))
    made = [Case(f"{one[0][:8]} {one[1][:12]} {k}", _request_case(url.port, one)) for k, one in enumerate(cases[:215])]

    def idle() -> str:
        held = [socket.create_connection((url.hostname, url.port)) for _ in range(300)]
        with open(f"/proc/{server.pid}/status") as status:
            threads = int(re.search(r"Threads:\s*(\d+)", status.read())[1])
        for one in held:
            one.close()
        return f"{threads} threads" if threads > 100 else ""

    def ends() -> str:
        server.send_signal(signal.SIGTERM)
        try:
            server.communicate(timeout=20)
        except subprocess.TimeoutExpired:
            server.kill()
            return "the server does not end"
        return ""

    return [*made, Case("300 idle connections", idle), Case("its end", ends)]


def _request_case(port: int | None, one: tuple[str, ...]) -> Callable[[], str]:
    method, path, host, kind, length, body = one

    def run() -> str:
        lines = [f"{method} {path} HTTP/1.1", f"Host: {host}", f"Content-Type: {kind}", f"Content-Length: {length}"]
        with socket.create_connection(("127.0.0.1", port), timeout=15) as made:
            with contextlib.suppress(ConnectionError):
                made.sendall("\r\n".join([*lines, "Connection: close", "", body]).encode())
            try:
                answer = made.recv(200)
            except TimeoutError:
                return "no answer within 15 s"
            except ConnectionError:
                return ""  # closed while more was sent than is read
        status = re.match(rb"HTTP/1\.[01] (\d+)", answer)
        if status is None:
            return f"no answer: {answer[:60]!r}"
        strange = "evil" in host or not host or "null" in host
        return "served" if status[1] == b"200" and strange else ""

    return run


def limits(folder: Path, seed: int) -> list[Case]:
    """Time limits with many fields and cells: S and max(2 s, S / 10) more, beside the start of the process."""
    many = {
        "11 fields": ["ghosts", "singlet_window_detector", "--rays", "1e6", "--field-deg", "0:10:1"],
        "41 fields": ["ghosts", "singlet_window_detector", "--rays", "1e6", "--field-deg", "0:10:0.25"],
        "161 fields": ["ghosts", "singlet_window_detector", "--rays", "1e6", "--field-deg", "0:8:0.05"],
        "121 cells": ["sweep", "singlet_window_detector", "--rays", "1e6", "--no-cache", "--field-deg", "0:6:0.05"],
        "PST": ["pst", "plate", "--rays", "4e9"],
        "objects": ["objects", "plate", "--rays", "4e9"],
    }

    def case(name: str, words: list[str]) -> Case:
        def run() -> str:
            began = time.monotonic()
            try:
                done = subprocess.run([*MISTRAY, *words, "--threads", "1", "--seconds", "10"], cwd=folder,
                                      capture_output=True, timeout=150)  # fmt: skip
            except subprocess.TimeoutExpired:
                return "no end within 150 s"
            took = time.monotonic() - began
            if done.returncode not in (0, 2):
                return f"exit code {done.returncode}: {done.stderr[-200:]!r}"
            return f"it took {took:.1f} s" if took > 10 + SLACK_S + 1 else ""

        return Case(name, run)

    return [case(*one) for one in many.items()]
