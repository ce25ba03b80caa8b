"""z-tests with a stated false-alarm probability; a failure is one line that says by how much."""

from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike


def z_limit(comparisons: int = 1, false_alarm: float = 1e-3) -> float:
    """Largest |z| so that all comparisons together fail by chance with ``false_alarm``: two-sided, Šidák."""
    if comparisons < 1 or not 0 < false_alarm < 1:
        raise ValueError(f"{comparisons} comparisons with false alarm {false_alarm}")
    single = -np.expm1(np.log1p(-false_alarm) / comparisons)
    return -NormalDist().inv_cdf(single / 2)


def z_score(measured: ArrayLike, expected: ArrayLike, standard_error: ArrayLike, floor: float = 0.0) -> np.ndarray:
    """(measured - expected) / standard error; 0 where both agree within ``floor`` absolutely, inf where se is 0."""
    difference = np.asarray(measured, dtype=float) - np.asarray(expected, dtype=float)
    se = np.broadcast_to(np.asarray(standard_error, dtype=float), difference.shape)
    if np.any(~np.isfinite(difference)) or np.any(~(se >= 0)):
        raise ValueError("measured, expected and standard error must be finite, the error not negative")
    close = np.abs(difference) <= floor
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(close, 0.0, difference / se)


def mean_and_error(values: ArrayLike) -> tuple[float, float]:
    sample = np.asarray(values, dtype=float)
    return float(sample.mean()), float(sample.std(ddof=1) / np.sqrt(len(sample)))


def assert_z(
    what: str,
    measured: ArrayLike,
    expected: ArrayLike,
    standard_error: ArrayLike,
    *,
    k: float | None = None,
    false_alarm: float = 1e-3,
    floor: float = 0.0,
    names: list[str] | None = None,
) -> None:
    """Fails where measured differs by more than k standard errors (None: `z_limit` of all) and more than ``floor``."""
    z = np.atleast_1d(z_score(measured, expected, standard_error, floor))
    limit = z_limit(z.size, false_alarm) if k is None else k
    worst = int(np.argmax(np.abs(z)))
    if abs(z.flat[worst]) > limit:
        m, e, s = (np.broadcast_to(v, z.shape).flat[worst] for v in (measured, expected, standard_error))
        label = f" [{names[worst] if names else worst}]" if z.size > 1 else ""
        raise AssertionError(
            f"{what}{label}: {m:.8g} ± {s:.2g}, expected {e:.8g}, off by {abs(z.flat[worst]):.2f} standard errors "
            f"(limit {limit:.2f}, {int(np.sum(np.abs(z) > limit))} of {z.size} beyond it)"
        )


def assert_within(
    what: str,
    measured: float,
    expected: float,
    standard_error: float,
    *,
    k: float = 4.0,
    relative: float = 1e-3,
    rounding: float = 1e-12,
) -> None:
    """Fails unless measured is within k standard errors (or ``rounding``) and within ``relative`` of expected."""
    assert_z(what, measured, expected, standard_error, k=k, floor=rounding * abs(expected))
    error = abs(measured - expected) / abs(expected)
    if error > relative:
        raise AssertionError(
            f"{what}: {measured:.8g}, expected {expected:.8g}, off by {error:.2e} relative (limit {relative:.1e})"
        )
