"""Options of a command line as an object, with the steps that all commands share: check, load, trace, write, print."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli.claims import claim_files, claim_folder
from mistray.cli.progress import progress_bar, terminal_bar, working
from mistray.cli.saved_run import SavedRun
from mistray.cli.signals import ignore
from mistray.errors import MistrayError
from mistray.interrupts import check, later
from mistray.ranges import SECONDS
from mistray.supervisor import INTERRUPTED
from mistray.time_budget import within
from mistray.toolkit.arguments import as_text
from mistray.toolkit.command import RECORDED
from mistray.toolkit.field_options import flag
from mistray.toolkit.shared_options import NAMES

START_S = 1.7  # what `Options.start` takes on a free machine of 2024, in which a report takes `PAGE_S`
PAGE_S = 3.0
MOST_OF_PAGE = 0.5  # of the time that is left

if TYPE_CHECKING:
    from mistray.files.irradiance_files import IrradianceMap
    from mistray.scene import Rules
    from mistray.toolkit.pages.model import Report


def print_json(record: Mapping[str, Any], files: Sequence[Path] = ()) -> None:
    """Print one JSON object: the entries of the record, and the names of written files; see docs/json.md."""
    import json

    print(json.dumps({**record, "files": [str(file) for file in files]}, indent=2, allow_nan=False))


class Options(argparse.Namespace):
    """Options of a command as read by argparse, with the steps that all commands share."""

    def given(self, *names: str) -> dict[str, Any]:
        """Return the values of the named options that the user has set, by name."""
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def settings(self) -> dict[str, Any]:
        """Return the options that are fields of `mistray.trace.Settings`, by name; None for those not given."""
        return {name: getattr(self, name) for name in NAMES}

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Raise `MistrayError` if one of the named options is given; in the message `why` follows the option."""
        for name in names:
            value = getattr(self, name)
            if value is not None and value is not False and value != []:
                raise MistrayError(f"{flag(name)}{why}")

    def has(self, name: str) -> Any:
        """Return the value of an option; None if it is not set or the command does not have it."""
        return vars(self).get(name)

    @property
    def title(self) -> str:
        """
        Name of the scene for titles: that of its file, or of its folder if the file is called scene.xml.

        It is empty for a command without a scene.
        """
        from mistray.scene.titles import title_of_file

        if self.has("scene") is None:
            return ""
        return as_text(title_of_file(Path(self.scene).resolve()))

    def seconds_left(self, page_s: float = PAGE_S) -> float | None:
        """
        Return the time of --seconds that is left for traces, s, at least `SECONDS.low`; None if it is not given.

        Parameters
        ----------
        page_s : float
            Time of the report on a free machine that is as fast as the one on which `START_S` was measured, s. Without
            --out it is not used.
        """
        if self.seconds is None:
            return None
        left = float(self.seconds - (time.monotonic() - self.began))
        page = 0.0 if self.out is None else min(page_s * max(self.start_s / START_S, 1.0), MOST_OF_PAGE * left)
        return max(left - page, SECONDS.low)

    def check(self) -> None:
        """
        Raise `MistrayError` if options do not fit each other.

        These are weights without as many wavelengths, formats without --out or that cannot be written, and --resume
        without the place of a saved run.
        """
        if self.has("resume") and self.has("state") is None and self.out is None:
            either = "saved run; give --state FILE, or the --out DIR of that run"
            needed = either if "state" in vars(self) else "folder of the saved run; give --out"
            raise MistrayError(f"--resume needs the {needed}")
        if self.has("weights") is not None:
            if self.wavelength_nm is None:
                raise MistrayError("--weights without --wavelength-nm; give one wavelength for each weight")
            if len(self.weights) != len(self.wavelength_nm):
                raise MistrayError(
                    f"--weights has {len(self.weights)} values for {len(self.wavelength_nm)} of --wavelength-nm; "
                    "give one weight for each wavelength"
                )
        if self.has("formats"):
            if self.out is None:
                raise MistrayError("--formats writes files; say with --out where they shall go")
            from mistray.toolkit.pages.formats import require_formats

            require_formats(self.formats)

    def start(self) -> Path | None:
        """
        Check the options, choose the variant and threads before Mitsuba is imported, and check the folder of --out.

        Return the folder; None without --out or if the command writes no folder.
        """
        self.check()
        self.prepare_mitsuba()
        self.start_s = time.monotonic() - self.began
        return claim_folder(self) if self.folder_files else None

    def prepare_mitsuba(self) -> None:
        """Choose the Mitsuba variant and the number of threads; call it before anything imports Mitsuba."""
        from mistray._mitsuba_compat import silence_warnings
        from mistray._variant import ensure_variant, set_threads, use_plugins

        with later():  # an interrupt may crash Mitsuba and Dr.Jit while they start
            if self.has("plugin"):
                use_plugins(self.plugin)
            ensure_variant(self.has("variant"))  # settles libLLVM
            if self.has("threads") is not None:
                set_threads(self.threads)
            silence_warnings()
        check()

    def claim(self) -> list[Path]:
        """
        Return the files that the options name as outputs.

        Raise `MistrayError` if one of them must not be written.
        """
        given = [getattr(self, name) or [] for name in self.outputs]
        paths = [path for one in given for path in (one if isinstance(one, list) else [one])]
        claim_files(self, *paths)
        return paths

    def claim_output(self, default: Path) -> Path:
        """Return the file of --output, else `default`; raise `MistrayError` if it cannot or must not be written."""
        output = Path(self.output or default)
        if not output.parent.is_dir():
            raise MistrayError(f"output '{output}': the folder '{output.parent}' does not exist; make it first")
        claim_files(self, output)
        return output

    def saved_run(self, name: str, what: Callable[[], str]) -> SavedRun:
        """
        Return the saved run in the file of --state, else in the file `name` of --out, or in no file.

        `what` describes its contents.

        Raises
        ------
        MistrayError
            If the file is a folder or must not be written, or there is no saved run to resume.
        """
        path: Path | None = self.has("state")
        if path is not None:
            claim_files(self, path)
        elif name and self.out is not None:
            path = self.out / name
        if path is not None and path.is_dir():
            raise MistrayError(f"--state {path} is a directory; name a file")
        if path is not None and self.resume and not path.exists():
            raise MistrayError(f"--resume: there is no saved run '{path}'; run without --resume first")
        return SavedRun(path, what, self.resume)

    def interrupted(self, kept: str) -> int:
        """Print that the command is interrupted and what is kept; return the exit code 130."""
        ignore()
        print(f"mistray: interrupted; {kept}", file=sys.stderr)
        return INTERRUPTED

    def bar(self, form: str, what: str, total: float = 1.0) -> contextlib.AbstractContextManager[Any | None]:
        """
        Return a context with a progress bar; `form`, `what` and `total` are parameters of `terminal_bar`.

        It yields the bar, or None with --quiet or if stderr is not a terminal.
        """
        return terminal_bar(self, form, what, total)

    def check_pictures(self, *names: str) -> None:
        """Raise `MistrayError` if the file name of a picture option does not end in .png, .svg or .pdf."""
        for path in self.given(*names).values():
            if path.suffix.lower() not in (".png", ".svg", ".pdf"):
                raise MistrayError(f"picture '{path}': its name must end in .png, .svg or .pdf")

    def working(self, what: str) -> contextlib.AbstractContextManager[None]:
        """Return a context that shows the elapsed time of work `what` without countable steps, see `working`."""
        return working(what, bool(self.has("quiet")))

    def rules(self) -> Rules:
        """Return the coatings, paints and scatter models that --coating, --paint and --scatter give to surfaces."""
        from mistray.scene import Rules

        scatter: dict[str, list[str]] = {}
        for pattern, model in self.has("scatter") or ():
            scatter.setdefault(pattern, []).append(model)
        return Rules(dict(self.has("coating") or ()), dict(self.has("paint") or ()), scatter)

    def load(self) -> Any:
        """Load and return the scene, with --coating, --paint and --scatter applied."""
        from mistray.scene import load
        from mistray.scene.coat import coated_scene

        rules = self.rules()
        with self.working(f"loading {self.scene}"):
            if not rules:
                return load(self.scene, self.has("source"), self.sensors())
            scene, found = coated_scene(self.scene, rules, self.has("source"), self.sensors())
        if not self.has("quiet"):
            for note in found.notes:
                print(f"mistray: note: {note}", file=sys.stderr)
        return scene

    def sensors(self) -> list[str]:
        """Return the sensors of --probe, --far-field, --surface-maps and --flux-split, as texts for `mistray.load`."""
        texts = [f"{kind}:{text}" for kind in ("probe", "far_field") for text in self.has(kind) or ()]
        of_surfaces = {kind: self.has(kind) for kind in ("surface_maps", "flux_split")}
        return texts + [f"{kind}:{' '.join(words)}" for kind, words in of_surfaces.items() if words is not None]

    def workers(self) -> contextlib.AbstractContextManager[None]:
        """Return a context within which the workers of --scheduler trace; it does nothing without --scheduler."""
        if self.has("scheduler") is None:
            return contextlib.nullcontext()
        from mistray.cluster import distribute

        return distribute(self.scheduler)

    def stepping(self) -> contextlib.AbstractContextManager[Callable[[float, float], None] | None]:
        """
        Return a context with a progress bar; it yields the function (done, total) that advances the bar.

        With --quiet, or if stderr is not a terminal, it yields None.
        """
        return progress_bar(self)

    @contextlib.contextmanager
    def tracing(self) -> Iterator[Callable[[float, float], None] | None]:
        """
        Let a block trace by the workers of --scheduler, if given; yield the function (done, total) of its progress bar.

        With --quiet, or if stderr is not a terminal, yield None.
        """
        with self.workers(), self.stepping() as progress:
            yield progress

    def write(
        self,
        make: Callable[[str, str], Report],
        scene: Callable[[Path], str] | None = None,
        maps: Mapping[str, IrradianceMap] | None = None,
        note: str = "",
    ) -> list[Path]:
        """
        Write a report into the folder of --out, and its tables and maps in the --formats as well.

        Parameters
        ----------
        make : callable
            Function from the name of the optical system and the command line to the report.
        scene : callable, optional
            Function from the folder to the text of a scene.xml that is written, too.
        maps : mapping, optional
            Irradiance maps, keyed by file name without ending; by default those of the report.
        note : str
            Text that follows the name of the optical system in the title.

        Returns
        -------
        list of Path
            Written files; empty without --out.
        """
        if self.out is None:
            return []
        from mistray.replace_folder import replacing_folder
        from mistray.toolkit.pages.formats import write_formats
        from mistray.toolkit.pages.output import write_report
        from mistray.toolkit.pages.own_sections import with_own_sections

        seconds = self.seconds_left(0.0) if self.has("seconds") else None
        with self.working("drawing the report"), within(seconds), replacing_folder(self.out):
            report = with_own_sections(make(f"{self.title}{note}", self.command_line))
            report = replace(report, json={name: {**one, RECORDED: self.asked} for name, one in report.json.items()})
            files = write_report(report, self.out, scene(self.out) if scene else "")
            facts = {"command": self.command_line}
            more = self.has("formats") or ()
            return files + write_formats(more, self.out, report.csv, maps or report.maps, facts, report)

    def say(
        self,
        record: Callable[[], Mapping[str, Any]],
        text: Callable[[], str],
        files: Sequence[Path] = (),
    ) -> int:
        """Print a result as JSON with the names of its files, or as text unless --quiet is given; return 0."""
        if self.json:
            print_json({**record(), RECORDED: self.asked}, files)
        elif not self.has("quiet"):
            print(text())
        return 0

    def tell(self, record: Callable[[], Mapping[str, Any]], text: Callable[[], str], files: Sequence[Path]) -> int:
        """Print a result as `say` does, then the names of the written files below a text. Return the exit code 0."""
        wrote = f"\n\nwrote {', '.join(map(str, files))}" if files else ""
        return self.say(record, lambda: f"{text()}{wrote}", files)

    def show(
        self,
        record: Callable[[], Mapping[str, Any]],
        text: Callable[[], str],
        files: Sequence[Path],
        result: Any = None,
    ) -> int:
        """
        Print a result as `say` does, with the path of its page at the end of a text.

        Sections that users have added for `result` are included, and the exit code 0 is returned.
        """
        from mistray.toolkit.pages.own_sections import own_sections, section_record, section_texts

        page = next((file.name for file in files if file.suffix == ".html"), "report.html")
        below = f"\n\n{len(files)} files in {self.out}; open {self.out / page}" if files else ""
        return self.say(
            lambda: {**record(), **section_record(own_sections(result))},
            lambda: "\n\n".join([text(), *section_texts(own_sections(result))]) + below,
            files,
        )
