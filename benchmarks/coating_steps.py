"""How much of a coating optimisation of 100 steps goes into tracing: walks and their derivatives over the wall time."""

from __future__ import annotations

from collections.abc import Iterator

from rows import Row

from mistray.optimize import optimize

STEPS = 100
BAR = 0.8
FIELDS_DEG = [0, 10]
WAVELENGTHS_NM = [450, 550, 650]


def tracing_share(name: str, rays: int, steps: int = STEPS) -> Row:
    """
    Share of the search that is spent in the walks of the traces and of their derivatives.

    The rest is tables of R and T, their derivatives by the layers, the path tables, and the search itself.

    Parameters
    ----------
    name : str
        Shipped scene; every lens surface gets four layers.
    rays : int
        Start rays at each of the fields, shared by the wavelengths.
    steps : int
        Steps of Adam, each of one evaluation.
    """
    study = {
        "term": [
            {
                "kind": "path_power",
                "goal": "minimise",
                "selection": "ghost",
                "field_deg": FIELDS_DEG,
                "wavelength_nm": WAVELENGTHS_NM,
                "rays": rays,
                "max_reflections": 2,
            }
        ],
        "coating": [{"name": "AR", "surfaces": "all", "preset": "bbar4", "thickness_nm": [5, 260]}],
        "optimizer": {"method": "adam", "steps": steps, "step_size": 0.002, "tolerance": 0, "starts": 1},
    }
    result = optimize(name, study, verification_seeds=2)
    assert len(result.steps) == steps + 1
    return Row(
        f"{name}-{rays}",
        f"`{name}`: share of {steps} steps of a coating optimisation that is tracing, {rays} rays at each field",
        f"{result.traced_seconds:.1f} s",
        f"{result.search_seconds:.1f} s",
        result.traced_seconds / result.search_seconds,
        BAR,
    )


def rows(quick: bool) -> Iterator[Row]:
    """Rows of the part `coating_steps`."""
    for rays in (600,) if quick else (60_000, 200_000):
        yield tracing_share("cooke_triplet", rays, 2 if quick else STEPS)


if __name__ == "__main__":
    print(*rows(False), sep="\n")
