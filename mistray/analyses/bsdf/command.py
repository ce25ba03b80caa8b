"""Command `mistray bsdf`, which prints BSDF and total integrated scatter of a scatter model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.field_options import group, options_of, request_of
from mistray.toolkit.shared_options import FORCE, JSON, PLOT, written

if TYPE_CHECKING:
    from mistray.cli.parsed_options import Options


def model_argument() -> Option:
    """
    Return the argument that names the scatter model.

    It is made on demand, as its help lists all models and needs NumPy.
    """
    from mistray.analyses.bsdf.models import known_models

    return Option("model", known_models(), metavar="MODEL")


def model_options() -> Group:
    """Return the options for the parameters of all scatter models."""
    from mistray.analyses.bsdf.models import parameter_options

    return parameter_options()


COMMAND = Command(
    "bsdf",
    "BSDF and total scatter of a scatter model",
    "Evaluate a scatter model: its BSDF against |β - β0| and against the angle of scatter, and the\n"
    "light that it scatters (TIS) at several angles of incidence. Pictures, curves and tables.",
    (
        "mistray bsdf abg --A 0.0025 --B 0.001 --g 1.8 --plot abg.png",
        "mistray bsdf abg --rms-nm 5 --correlation-um 100 --wavelength-nm 500 --R 0.95",
        "mistray bsdf harvey_shack --rms-nm 4 --event transmission --back 1.5333 --plot polished.png",
        "mistray bsdf particulate --level 300 --event transmission --plot dust.png",
        "mistray bsdf paint --preset flat_black --json",
        "mistray bsdf measured.bsdf --table copy.csv",
        "mistray bsdf abg --A 2e-5 --B 1e-6 --g 2 --event transmission --hit-deg 30 --hit-sr 4e-6 --hit-before 0.125",
    ),
    lambda request: (
        model_argument(),
        *options_of(request.BsdfRequest)[:-3],
        PLOT,
        written("--plot-particles", "particulate: write a picture of the sizes and of the covered area"),
        written("--csv", "write the curves in the plane of incidence"),
        written("--table", "write a table over the hemisphere, for scenes: .bsdf (Zemax) or .csv"),
        FORCE,
        JSON,
        group("a world without importance sampling: rays until one finds a small detector", request.BsdfRequest, "hit"),
        model_options(),
    ),
    __package__,
)


def run(options: Options) -> int:
    """Run `mistray bsdf` with parsed options and return the exit code."""
    from mistray.analyses.bsdf.request import BsdfRequest

    request = request_of(BsdfRequest, vars(options))
    from mistray.analyses.bsdf.page import figure, record, text, write_curves, write_table
    from mistray.analyses.bsdf.run import run_bsdf
    from mistray.toolkit.figures.plots import write_figure

    options.check_pictures("plot", "plot_particles")
    if options.table is not None and options.table.suffix.lower() not in (".bsdf", ".csv"):
        raise MistrayError(f"table '{options.table}': its name must end in .bsdf (Zemax) or .csv")
    if options.plot_particles is not None and options.model != "particulate":
        raise MistrayError(f"{options.model} has no particles; leave --plot-particles out")
    files = options.claim()
    with options.working("evaluating the model"):
        found = run_bsdf(options.model, vars(options), request)
    if options.plot is not None:
        write_figure(figure(found), options.plot)
    if options.plot_particles is not None:
        from mistray.analyses.bsdf.figures import particles_figure

        particles: Any = found.model
        write_figure(particles_figure(particles.cleanliness, particles.slope), options.plot_particles)
    if options.csv is not None:
        write_curves(found, options.csv, options.command_line)
    if options.table is not None:
        write_table(found, options.table, options.command_line)
    return options.tell(lambda: record(found), lambda: text(found), files)
