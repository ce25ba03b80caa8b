"""Coherent thin-film stacks between two media: amplitudes, reflectance and transmittance for s and p.

Lengths in nm, angles as cosines, N = n + ik with exp(-iωt), so that k ≥ 0 absorbs. The tangential index β = n₀ sin θ is
real; in a layer q = √(N² - β²) is the normal index and δ = 2πqd/λ the phase. With tangential fields E and H = -iG for s
(their roles change for p), the fields on the two faces of a layer are linked by Abelès' characteristic matrix (M. Born
and E. Wolf, *Principles of Optics*, 7th ed., section 1.6; H. A. Macleod, *Thin-Film Optical Filters*, 5th ed.,
chapter 2)::

    E_front = cos δ E_back - g (sin δ)/q G_back        g = 1 for s, N² for p
    G_front = cos δ G_back + (q sin δ)/g E_back

Numerically:

- All entries are even in q: a layer needs no choice of branch, and nothing happens at its critical angle. Where δ is
  small they are power series in δ².
- In an evanescent or absorbing layer the entries grow as exp(Im δ). This factor is taken out of the matrix and goes
  into the transmission, where it may underflow but cannot overflow.
- The fields are scaled back to length 1 now and then, which changes no ratio.
- Everything is float64 inside. The phases of a thick stack are many radians, and R of a mirror follows them steeply.
  float32 would be about twice as fast, with errors in the fifth or sixth digit, R + T = 1 included.

The amplitudes are those of the electric field with the signs of S. J. Byrnes, *Multilayer optical calculations*,
arXiv:1603.02720 (package ``tmm``): on bare glass at normal incidence r_s = -r_p.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from mistray.errors import MistrayError
from mistray.physics._arrays import Arithmetic, arithmetic
from mistray.ranges import several

Pair = tuple[Any, Any]

# Below this |δ²| a layer's matrix is summed as series; the first terms left out, δ⁶/6! and δ⁶/7!, are below 2e-18.
# Above it, derivatives with respect to q² suffer from rounding, about 1e-16/δ² and so below 1e-11.
_SERIES = 1e-5
# Smallest |q²| apart from rounding: a root of zero would have no derivative. R and T change by about its root, 1e-30.
_FLOOR = 1e-60
# Smallest cosine of incidence. At grazing incidence q vanishes in all media of the same index and r would be 0/0; here
# q² is still well above the floor. R and T move by a few times this number.
_GRAZING = 1e-26
# Layers between two scalings. A layer changes the length of (E, G) at most by about 2πd/λ |N²| (1e9 for a metre of
# silver) or by its inverse.
_SCALE_EVERY = 8


class _Fields(NamedTuple):
    """Wave amplitudes in front of a thin-film stack and the field behind it, for one polarisation."""

    forward: Any  # Y₀E + H: 2 Y₀ times the incident wave
    backward: Any  # Y₀E - H: 2 Y₀ times the reflected wave
    admittance_front: Any  # Y₀ = q/g
    admittance_back: Any
    passed: Any  # E behind the stack; real and positive


class _Layer(NamedTuple):
    """Characteristic matrix of a layer: f cos δ, f sin δ / q, f q sin δ, and a scale factor f against overflow."""

    cos: Any
    over: Any
    times: Any
    factor: Any


def amplitudes(
    n_incident: Any,
    n_layers: complex | Sequence[Any],
    d_nm: float | Sequence[Any],
    n_substrate: Any,
    wavelength_nm: Any,
    cos_incident: Any,
) -> tuple[Pair, Pair]:
    """
    Return the complex amplitudes of reflection and transmission of the electric field.

    Parameters
    ----------
    n_incident, n_substrate : real or complex number or array
        Index n + ik of the medium of the incident light and of the medium beyond the stack; n > 0, k ≥ 0.
    n_layers : number, or sequence of real or complex numbers or arrays
        Index of the layer, or of each layer, the first one on the incident side; k ≥ 0, not 0. May be empty. Real
        indices halve the cost.
    d_nm : number, or sequence of real numbers or arrays
        Thickness of the layer, or of each, nm, ≥ 0.
    wavelength_nm : real number or array
        Vacuum wavelength, nm, > 0.
    cos_incident : real number or array
        Cosine of the angle of incidence, in [0, 1]. In an absorbing medium the angle follows from Snell's law with the
        real part of the index.

    Returns
    -------
    (r_s, r_p), (t_s, t_p)
        Complex r at the first face and t at the last, for fields of exp(-iωt); at normal incidence r_s = -r_p. All
        arguments broadcast. Floats and NumPy arrays give NumPy arrays in float64 precision. Dr.Jit arrays give arrays
        of their own precision, with derivatives with respect to every argument.

    Raises
    ------
    MistrayError
        If there are not as many thicknesses as indices.
    """
    solved = _solve(n_incident, n_layers, d_nm, n_substrate, wavelength_nm, cos_incident)
    return _amplitudes(*solved, n_incident, n_substrate)


def reflectance_transmittance(
    n_incident: Any,
    n_layers: complex | Sequence[Any],
    d_nm: float | Sequence[Any],
    n_substrate: Any,
    wavelength_nm: Any,
    cos_incident: Any,
) -> tuple[Pair, Pair]:
    """
    Return the fractions of the incident power that are reflected and that enter the substrate.

    Parameters
    ----------
    n_incident, n_layers, d_nm, n_substrate, wavelength_nm, cos_incident
        Parameters and errors of `amplitudes`.

    Returns
    -------
    (R_s, R_p), (T_s, T_p)
        Real fractions ≥ 0; types as in `amplitudes`. If the incident medium is lossless, R + T ≤ 1 to rounding, and the
        stack absorbs the rest. If it absorbs, incident and reflected wave interfere, and R + T may exceed 1 by about
        k/n.
    """
    return _shares(*_solve(n_incident, n_layers, d_nm, n_substrate, wavelength_nm, cos_incident))


def amplitudes_and_shares(
    n_incident: Any,
    n_layers: complex | Sequence[Any],
    d_nm: float | Sequence[Any],
    n_substrate: Any,
    wavelength_nm: Any,
    cos_incident: Any,
) -> tuple[Pair, Pair, Pair, Pair]:
    """
    Return (r_s, r_p), (t_s, t_p), (R_s, R_p), (T_s, T_p): `amplitudes` and `reflectance_transmittance` at one cost.

    Parameters
    ----------
    n_incident, n_layers, d_nm, n_substrate, wavelength_nm, cos_incident
        Parameters and errors of `amplitudes`.
    """
    solved = _solve(n_incident, n_layers, d_nm, n_substrate, wavelength_nm, cos_incident)
    return *_amplitudes(*solved, n_incident, n_substrate), *_shares(*solved)


def _amplitudes(
    ops: Arithmetic, polarisations: tuple[_Fields, _Fields], n_incident: Any, n_substrate: Any
) -> tuple[Pair, Pair]:
    r_s, r_p = (ops.result(m.backward / m.forward) for m in polarisations)
    t_s, t_p = (2 * m.passed * (m.admittance_front / m.forward) for m in polarisations)
    front, back = (_number(ops, n) for n in (n_incident, n_substrate))
    return (r_s, r_p), (ops.result(t_s), ops.result(t_p * front / back))


def _shares(ops: Arithmetic, polarisations: tuple[_Fields, _Fields]) -> tuple[Pair, Pair]:
    R, T = [], []
    for m in polarisations:
        incident = _norm2(ops, m.forward)
        Y = m.admittance_front
        flux = ops.re(Y) + ops.im(Y) * (ops.im(Y) / ops.re(Y))  # |Y|² / Re Y
        R.append(ops.result(_norm2(ops, m.backward) / incident))
        T.append(ops.result(4 * flux * ops.re(m.admittance_back) * (m.passed * m.passed) / incident))
    return (R[0], R[1]), (T[0], T[1])


def _solve(
    n_incident: Any,
    n_layers: complex | Sequence[Any],
    d_nm: float | Sequence[Any],
    n_substrate: Any,
    wavelength_nm: Any,
    cos_incident: Any,
) -> tuple[Arithmetic, tuple[_Fields, _Fields]]:
    """
    Return array functions, and for s and p the fields in front of a stack whose transmitted wave has amplitude 1.

    Parameters are those of `amplitudes`. Raise `MistrayError` if the numbers of indices and thicknesses differ.
    """
    n_layers, d_nm = several(n_layers), several(d_nm)
    if len(n_layers) != len(d_nm):
        raise MistrayError(f"stack: {len(n_layers)} indices and {len(d_nm)} thicknesses; give one of each per layer")
    ops = arithmetic(n_incident, *n_layers, *d_nm, n_substrate, wavelength_nm, cos_incident)
    n_0 = ops.real(ops.re(n_incident))
    normal = n_0 * ops.maximum(ops.real(cos_incident), _GRAZING)
    wavenumber = 2 * math.pi / ops.real(wavelength_nm)

    def squares(index: Any) -> Pair:
        """Return N² and q² = N² - n₀² + (n₀ cos θ)², without cancellation; real for a real index."""
        n = ops.real(ops.re(index))
        index2, q2 = n * n, (n - n_0) * (n + n_0) + normal * normal
        if ops.is_real(index):
            return index2, q2
        k = ops.real(ops.im(index))
        return ops.complex(index2 - k * k, 2 * n * k), ops.complex(q2 - k * k, 2 * n * k)

    def admittances(index: Any) -> Pair:
        """Return the admittances of a medium of given index: Y = q for s and q/N² for p."""
        index2, q2 = squares(index)
        q, _ = _root(ops, ops.complex(ops.re(q2), ops.im(q2)))
        return q, q / index2

    one = ops.real(1.0)
    back = admittances(n_substrate)
    fields = [(ops.complex(one, 0 * one), ops.complex(-ops.im(Y), ops.re(Y)), one) for Y in back]
    for j in reversed(range(len(n_layers))):
        index2, q2 = squares(n_layers[j])
        phase_per_q = wavenumber * ops.real(d_nm[j])
        layer = (_lossless if ops.is_real(n_layers[j]) else _absorbing)(ops, q2, phase_per_q)
        entries = ((layer.over, layer.times), (layer.over * index2, layer.times / index2))
        for i, (over, under) in enumerate(entries):
            E, G, passed = fields[i]
            E, G = layer.cos * E - over * G, layer.cos * G + under * E
            passed = passed * layer.factor
            if j > 0 and j % _SCALE_EVERY == 0:
                scale = ops.detach(1 / ops.sqrt(_norm2(ops, E) + _norm2(ops, G)))
                E, G, passed = scale * E, scale * G, scale * passed
            fields[i] = E, G, passed
    results = []
    for (E, G, passed), Y, Y_back in zip(fields, admittances(n_incident), back, strict=True):
        incident, H = Y * E, ops.complex(ops.im(G), -ops.re(G))
        results.append(_Fields(incident + H, incident - H, Y, Y_back, passed))
    return ops, (results[0], results[1])


def _lossless(ops: Arithmetic, q2: Any, phase_per_q: Any) -> _Layer:
    """Return the matrix of a layer of real index, from q² (< 0: evanescent wave) and the phase δ per q, rad."""
    propagates = q2 >= 0
    q = ops.sqrt(ops.select(propagates, q2, -q2) + _FLOOR)
    phase = q * phase_per_q
    sin, cos = ops.sincos(phase)
    decay = ops.exp(-phase)
    cos = ops.select(propagates, cos, 0.5 + 0.5 * decay * decay)
    sin = ops.select(propagates, sin, 0.5 - 0.5 * decay * decay)
    factor = ops.select(propagates, 1 + 0 * decay, decay)
    general = _Layer(cos, sin / q, sin * ops.select(propagates, q, -q), factor)
    return _joined(ops, phase * phase < _SERIES, q2, phase_per_q, general)


def _absorbing(ops: Arithmetic, q2: Any, phase_per_q: Any) -> _Layer:
    """Return the characteristic matrix of a layer of complex index, from q² and the phase δ per q, rad."""
    q, modulus = _root(ops, q2)
    sin, cos = ops.sincos(ops.re(q) * phase_per_q)
    decay = ops.exp(-ops.im(q) * phase_per_q)
    even, odd = 0.5 + 0.5 * decay * decay, 0.5 - 0.5 * decay * decay
    inverse = 1 / modulus * ops.complex(ops.re(q), -ops.im(q))
    sin, cos = ops.complex(sin * even, cos * odd), ops.complex(cos * even, -sin * odd)
    general = _Layer(cos, sin * inverse, sin * q, decay)
    return _joined(ops, modulus * phase_per_q * phase_per_q < _SERIES, q2, phase_per_q, general)


def _joined(ops: Arithmetic, small: Any, q2: Any, phase_per_q: Any, general: _Layer) -> _Layer:
    """Return a layer's matrix: where `small`, a series in its phase δ, from q² and δ per q, rad; else `general`."""
    x = ops.select(small, phase_per_q, 0 * phase_per_q)
    w = q2 * (x * x)
    cos = 1 - w * (1 / 2 - w * (1 / 24))
    over = (1 - w * (1 / 6 - w * (1 / 120))) * x
    series = _Layer(cos, over, over * q2, 1 + 0 * x)
    return _Layer(*(ops.select(small, a, b) for a, b in zip(series, general, strict=True)))


def _root(ops: Arithmetic, z: Any) -> Pair:
    """
    Return the square root of a complex array, and the modulus of the array.

    The real part is ≥ 0 if Re z ≥ 0, the imaginary part is ≥ 0 otherwise. Both are ≥ 0 if Im z ≥ 0, for a wave that
    goes forward and decays. The branch cut is the negative imaginary axis, so the root is smooth at k = 0.
    """
    x, y = ops.re(z), ops.im(z)
    modulus = ops.sqrt(x * x + y * y + _FLOOR * _FLOOR)
    right = x >= 0
    large = ops.sqrt(0.5 * (modulus + ops.select(right, x, -x)))
    small = 0.5 * y / large
    return ops.complex(ops.select(right, large, small), ops.select(right, small, large)), modulus


def _norm2(ops: Arithmetic, z: Any) -> Any:
    """Return the squared modulus |z|² of a complex array."""
    return ops.re(z) * ops.re(z) + ops.im(z) * ops.im(z)


def _number(ops: Arithmetic, index: Any) -> Any:
    """Return a refractive index n + ik as a complex array of the formula's array library."""
    return ops.complex(ops.real(ops.re(index)), ops.real(ops.im(index)))
