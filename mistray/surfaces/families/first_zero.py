"""Distance along a ray, mm, at which it first crosses a surface z = sag(x, y), by bracketing and Newton steps."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi

ITERATIONS = 24
# Newton steps end when one is this small, in units of the size; a last one then squares the error
CONVERGED = 1e-3
UNBOUNDED = 1e30  # bound of a second derivative that is not known, 1/mm


# More than 8 parameters: the ray, the surface and the search
def first_zero(
    f: Callable[[mi.Float], tuple[mi.Float, mi.Float]],
    monotonic: mi.Bool,
    bend: mi.Float,
    length: mi.Float,
    size: mi.Float,
    own: mi.Bool,
    active: mi.Bool,
    intervals: int,
) -> tuple[mi.Float, mi.Bool]:
    """
    Return the distance s, mm, of the first zero of f(s) = z - sag along a ray, and whether there is one.

    Parameters
    ----------
    f : callable
        Height over the surface at a distance along the ray, mm, and its derivative.
    monotonic : mi.Bool
        Whether the ray is steeper than the surface anywhere, so that f only rises or only falls, and has one zero at
        most.
    bend : mi.Float
        Upper bound of the second derivative of f, 1/mm; `UNBOUNDED`: not known. If f cannot turn back on the stretch by
        this bound, it counts as monotonic, too.
    length : mi.Float
        Length of the ray's stretch, mm.
    size : mi.Float
        Size of the surface, mm.
    own : mi.Bool
        Whether the ray starts on the surface; its start then does not count as a zero.
    active : mi.Bool
        Whether the lane has a ray.
    intervals : int
        Number of equal intervals in which the stretch is searched if f may not be monotonic. The search ends where f
        changes sign, or where an extremum within an interval lies beyond zero. Steps without room for a zero, by
        `bend`, may be longer.

    Returns
    -------
    s : mi.Float
        Distance of the zero from the start of the stretch, mm.
    found : mi.Bool
        Whether a zero was found on the stretch.
    """
    stride = length / intervals
    f0, g0 = f(mi.Float(0))
    f0 = dr.select(own, dr.mulsign(mi.Float(1e-30), g0), f0)  # on the surface: the sign is the one it leaves with

    def sign(v: mi.Float) -> mi.Float:
        return dr.mulsign(mi.Float(1), v)

    # More than 8 parameters: the state of the loop
    def step(s, fs, gs, lo, hi, flo, fhi, found, going):  # type: ignore[no-untyped-def]
        # f is not zero before a parabola with its value and slope that bends towards zero as much as f may
        away = dr.mulsign(gs, fs)
        root = dr.sqrt(dr.fma(away, away, 2 * bend * dr.abs(fs)))
        clear = dr.select(away > 0, (away + root) / bend, 2 * dr.abs(fs) / (root - away))
        t = dr.minimum(s + dr.select(clear > stride, clear, stride), length)
        ft, gt = f(t)
        crossed = sign(ft) != sign(fs)
        # f turns round inside the interval: does its extremum reach beyond zero?
        dips = ~crossed & (gs * fs < 0) & (gt * ft > 0)
        turn = dr.clip(s + (t - s) * gs / dr.select(dips, gs - gt, 1), s, t)
        fm, _ = f(turn)
        dips &= sign(fm) != sign(ft)
        now = going & (crossed | dips)
        lo, flo = dr.select(now, s, lo), dr.select(now, fs, flo)
        hi, fhi = dr.select(now, dr.select(crossed, t, turn), hi), dr.select(now, dr.select(crossed, ft, fm), fhi)
        return t, ft, gt, lo, hi, flo, fhi, found | now, going & ~now & (t < length)

    # A monotonic f comes to zero, or grows away from it
    monotonic = monotonic | (dr.abs(g0) > bend * length)  # not |=, which would change the caller's
    ahead = sign(f0) != sign(g0)
    zero = mi.Float(0)
    _, _, _, lo, hi, flo, fhi, found, _ = dr.while_loop(
        (zero, f0, g0, zero, length, zero, zero, active & monotonic & ahead, active & ~monotonic),
        lambda *v: v[8],
        step,
        labels=("s", "fs", "gs", "lo", "hi", "flo", "fhi", "found", "going"),
        mode="symbolic",
        label="bracket",
    )
    side = sign(dr.select(monotonic, f0, flo))

    def newton(i, s, lo, hi, ends, found, going):  # type: ignore[no-untyped-def]
        fs, gs = f(s)
        before = sign(fs) == side
        lo, hi = dr.select(before, s, lo), dr.select(before, hi, s)
        # The end of a monotonic stretch is a bracket only if f has another sign there
        ends &= before
        missed = ends & (s >= length)
        trial = s - fs / gs
        inside = (trial >= lo) & (trial <= hi)
        new = dr.select(inside, trial, dr.select(ends & (trial > hi), length, 0.5 * (lo + hi)))
        # Half of a short bracket is a short step, too, and does not show how near the zero is
        halved = ~inside & ~(ends & (trial > hi))
        going = going & ~missed & (halved | (dr.abs(new - s) > CONVERGED * size)) & (i < ITERATIONS)
        return i + 1, dr.select(missed, s, new), lo, hi, ends, found & ~missed, going

    chord = dr.clip(lo + (hi - lo) * flo / dr.select(flo == fhi, 1, flo - fhi), lo, hi)
    guess = dr.select(monotonic, dr.clip(-f0 / g0, 0, length), dr.select(own & (lo == 0), 0.5 * (lo + hi), chord))
    _, s, _, _, _, found, _ = dr.while_loop(
        (mi.UInt32(0), guess, lo, hi, mi.Bool(monotonic), mi.Bool(found), mi.Bool(found)),
        lambda *v: v[6],
        newton,
        labels=("i", "s", "lo", "hi", "ends", "found", "going"),
        mode="symbolic",
        label="newton",
    )
    last_f, last_g = f(s)
    last_step = last_f / last_g
    found &= dr.abs(last_step) < CONVERGED * size  # not where the steps ended at the rim, short of a crossing
    s -= last_step
    return s, found
