"""First hits of rays on single surfaces in their own frames, float64: quadratics, and interval subdivision with
rigorous bounds on the slope, so that no crossing is skipped; ``leaving`` marks rays that start on the surface."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Surface:
    def first_hit(self, origin: Array, direction: Array, leaving: Mask) -> Array:
        raise NotImplementedError

    def implicit(self, point: Array) -> tuple[Array, Array]:
        """F (n,) and its gradient (n, 3), which is along the normal; F = 0 on the unbounded sheet."""
        raise NotImplementedError

    def extent(self) -> float:
        """Radius in mm of a ball about the frame's origin that holds the surface."""
        raise NotImplementedError

    def normal(self, point: Array) -> Array:
        gradient = self.implicit(point)[1]
        return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))


def _nearest(candidates: list[tuple[Array, Mask]], size: int) -> Array:
    best = np.full(size, np.inf)
    for t, good in candidates:
        use = good & (t > 0) & (t < best)
        best[use] = t[use]
    return best


def _quadratic_roots(a: Array, b: Array, c: Array, leaving: Mask) -> list[tuple[Array, Mask]]:
    """Real roots of a t^2 + 2 b t + c with their masks; where ``leaving``, c is exactly 0 and t = 0 is dropped."""
    c = np.where(leaving, 0.0, c)
    disc = b * b - a * c
    real = disc >= 0
    q = -(b + np.copysign(np.sqrt(np.maximum(disc, 0.0)), b))
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = q / a, c / q
    first_ok = real & np.isfinite(first)
    second_ok = real & np.isfinite(second) & ~leaving
    return [(np.where(first_ok, first, 0.0), first_ok), (np.where(second_ok, second, 0.0), second_ok)]


def box_span(origin: Array, direction: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Path lengths (n,) between which rays are in a box; the first is the larger one where they miss it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.stack([(low - origin) / direction, (high - origin) / direction])
    still = direction == 0
    t[:, still] = np.array([[-np.inf], [np.inf]])
    t[1][still & ((origin < low) | (origin > high))] = -np.inf
    t.sort(axis=0)
    return t[0].max(axis=1), t[1].min(axis=1)


@dataclass(frozen=True)
class Plane(Surface):
    """z = 0 inside a ring or a rectangle, mm; the normal goes along ``sign`` z."""

    outer: float = np.inf
    inner: float = 0.0
    half_width: float = np.inf
    half_height: float = np.inf
    sign: float = 1.0

    def first_hit(self, origin: Array, direction: Array, leaving: Mask) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -origin[:, 2] / direction[:, 2]
        good = np.isfinite(t) & ~leaving
        t = np.where(good, t, 0.0)
        x, y = origin[:, 0] + t * direction[:, 0], origin[:, 1] + t * direction[:, 1]
        r2 = x * x + y * y
        good &= (r2 <= self.outer**2) & (r2 >= self.inner**2) if self.inner > 0 else r2 <= self.outer**2
        good &= (np.abs(x) <= self.half_width) & (np.abs(y) <= self.half_height)
        return _nearest([(t, good)], len(t))

    def implicit(self, point: Array) -> tuple[Array, Array]:
        return self.sign * point[:, 2], np.tile([0.0, 0.0, self.sign], (len(point), 1))

    def extent(self) -> float:
        return min(self.outer, float(np.hypot(self.half_width, self.half_height)))


@dataclass(frozen=True)
class Sphere(Surface):
    """Full sphere about the origin, ``radius`` in mm, normal outward for ``sign`` = 1."""

    radius: float
    sign: float = 1.0

    def first_hit(self, origin: Array, direction: Array, leaving: Mask) -> Array:
        b = np.einsum("ij,ij->i", origin, direction)
        c = np.einsum("ij,ij->i", origin, origin) - self.radius**2
        return _nearest(_quadratic_roots(np.ones_like(b), b, c, leaving), len(b))

    def implicit(self, point: Array) -> tuple[Array, Array]:
        return 0.5 * self.sign * (np.sum(point * point, axis=1) - self.radius**2), self.sign * point

    def extent(self) -> float:
        return self.radius


@dataclass(frozen=True)
class Frustum(Surface):
    """Cone, cylinder or flat annulus from (r0, z0) to (r1, z1) about z, mm; the normal points outwards or to +z."""

    r0: float
    z0: float
    r1: float
    z1: float

    def _line(self) -> tuple[float, float, float]:
        dr, dz = self.r1 - self.r0, self.z1 - self.z0
        length = float(np.hypot(dr, dz))
        m_r, m_z = dz / length, -dr / length
        if m_r < 0 or (m_r == 0 and m_z < 0):
            m_r, m_z = -m_r, -m_z
        return m_r, m_z, m_r * self.r0 + m_z * self.z0

    def first_hit(self, origin: Array, direction: Array, leaving: Mask) -> Array:
        m_r, m_z, k = self._line()
        if m_r == 0:
            lifted = origin - np.array([0.0, 0.0, self.z0])
            ring = Plane(outer=max(self.r0, self.r1), inner=min(self.r0, self.r1))
            return ring.first_hit(lifted, direction, leaving)
        q, dq = k - m_z * origin[:, 2], -m_z * direction[:, 2]
        a = m_r**2 * (direction[:, 0] ** 2 + direction[:, 1] ** 2) - dq**2
        b = m_r**2 * (origin[:, 0] * direction[:, 0] + origin[:, 1] * direction[:, 1]) - q * dq
        c = m_r**2 * (origin[:, 0] ** 2 + origin[:, 1] ** 2) - q**2
        candidates = []
        for t, real in _quadratic_roots(a, b, c, leaving):
            p = origin + t[:, None] * direction
            radius = np.hypot(p[:, 0], p[:, 1])
            along = (radius - self.r0) * (self.r1 - self.r0) + (p[:, 2] - self.z0) * (self.z1 - self.z0)
            length2 = (self.r1 - self.r0) ** 2 + (self.z1 - self.z0) ** 2
            nappe = k - m_z * p[:, 2] >= 0
            candidates.append((t, real & nappe & (along >= 0) & (along <= length2)))
        return _nearest(candidates, len(a))

    def implicit(self, point: Array) -> tuple[Array, Array]:
        m_r, m_z, k = self._line()
        radius = np.hypot(point[:, 0], point[:, 1])
        across = m_r * point[:, :2] / np.maximum(radius, 1e-300)[:, None]
        return m_r * radius + m_z * point[:, 2] - k, np.column_stack([across, np.full(len(point), m_z)])

    def extent(self) -> float:
        return float(max(np.hypot(self.r0, self.z0), np.hypot(self.r1, self.z1)))


@dataclass(frozen=True)
class Asphere(Surface):
    """z = c u / (1 + sqrt(1 - (1 + k) c^2 u)) + sum a_2i u^i, u = x^2 + y^2, in a ring or a rectangle, mm."""

    curvature: float
    conic: float = 0.0
    coefficients: tuple[tuple[int, float], ...] = ()
    outer: float = np.inf
    inner: float = 0.0
    half_width: float = np.inf
    half_height: float = np.inf
    reach: float = field(init=False)

    def __post_init__(self) -> None:
        reach = min(self.outer, float(np.hypot(self.half_width, self.half_height)))
        if not np.isfinite(reach):
            raise ValueError("an asphere needs semi_diameter or half_width and half_height")
        if (1 + self.conic) * (self.curvature * reach) ** 2 > 1:
            raise ValueError(f"asphere of curvature {self.curvature} and conic {self.conic} ends before r = {reach} mm")
        object.__setattr__(self, "reach", reach)

    def sag(self, u: Array) -> Array:
        root = np.sqrt(np.maximum(1 - (1 + self.conic) * self.curvature**2 * u, 0.0))
        z = self.curvature * u / (1 + root)
        for power, value in self.coefficients:
            z = z + value * u**power
        return z

    def _terms(self, u: Array) -> list[Array]:
        """d sag / d u term by term; each term is monotone in u."""
        root = np.sqrt(np.maximum(1 - (1 + self.conic) * self.curvature**2 * u, 1e-16))
        return [0.5 * self.curvature / root] + [i * value * u ** (i - 1) for i, value in self.coefficients]

    def slope_u(self, u: Array) -> Array:
        return np.sum(self._terms(u), axis=0)

    def implicit(self, point: Array) -> tuple[Array, Array]:
        u = point[:, 0] ** 2 + point[:, 1] ** 2
        across = -2 * self.slope_u(u)[:, None] * point[:, :2]
        return point[:, 2] - self.sag(u), np.column_stack([across, np.ones(len(point))])

    def extent(self) -> float:
        return float(np.hypot(self.reach, np.abs(self._sag_bounds()).max()))

    def _sag_bounds(self) -> tuple[float, float]:
        low = high = 0.0
        ends = np.array([self.inner**2, self.reach**2])
        only_conic = Asphere(self.curvature, self.conic, (), self.reach).sag(ends)
        low, high = low + only_conic.min(), high + only_conic.max()
        for power, value in self.coefficients:
            term = value * ends**power
            low, high = low + term.min(), high + term.max()
        pad = 1e-9 * (self.reach + high - low)
        return float(low - pad), float(high + pad)

    def _domains(self, o: Array, d: Array, start: Array) -> list[tuple[Array, Array]]:
        """Parts [a, b] of each ray that lie over the clear aperture and inside the slab of the sag."""
        sides = np.array([self.half_width, self.half_height])
        (z0, z1) = self._sag_bounds()
        low, high = box_span(o, d, np.append(-sides, z0), np.append(sides, z1))
        low = np.maximum(low, start)
        a = d[:, 0] ** 2 + d[:, 1] ** 2
        b = o[:, 0] * d[:, 0] + o[:, 1] * d[:, 1]
        c = o[:, 0] ** 2 + o[:, 1] ** 2

        def circle(radius: float) -> tuple[Array, Array]:
            disc = b * b - a * (c - radius**2)
            root = np.sqrt(np.maximum(disc, 0.0))
            with np.errstate(divide="ignore", invalid="ignore"):
                t0, t1 = (-b - root) / a, (-b + root) / a
            axial = a == 0
            inside = c <= radius**2
            t0 = np.where(axial, np.where(inside, -np.inf, np.inf), np.where(disc < 0, np.inf, t0))
            t1 = np.where(axial, np.where(inside, np.inf, -np.inf), np.where(disc < 0, -np.inf, t1))
            return t0, t1

        if np.isfinite(self.outer):
            t0, t1 = circle(self.outer)
            low, high = np.maximum(low, t0), np.minimum(high, t1)
        if self.inner == 0:
            return [(low, high)]
        t0, t1 = circle(self.inner)
        missed = t0 > t1
        before = np.where(missed, high, np.minimum(high, t0))
        after = np.where(missed, np.inf, np.maximum(low, t1))
        return [(low, before), (after, high)]

    def first_hit(self, origin: Array, direction: Array, leaving: Mask) -> Array:
        if self.curvature == 0 and not self.coefficients:
            plane = Plane(self.outer, self.inner, self.half_width, self.half_height)
            return plane.first_hit(origin, direction, leaving)
        start = np.where(leaving, 1e-9 * self.reach, 0.0)
        best = np.full(len(origin), np.inf)
        for low, high in self._domains(origin, direction, start):
            index = np.flatnonzero(low < high)
            self._search(origin, direction, index, low[index], high[index], best)
        return best

    def _value(self, o: Array, d: Array, t: Array) -> tuple[Array, Array, Array]:
        """F = z - sag along the ray, with u and du/dt."""
        x, y = o[:, 0] + t * d[:, 0], o[:, 1] + t * d[:, 1]
        u = x * x + y * y
        return o[:, 2] + t * d[:, 2] - self.sag(u), u, 2 * (x * d[:, 0] + y * d[:, 1])

    def _search(
        self, origin: Array, direction: Array, index: NDArray[np.intp], a: Array, b: Array, best: Array
    ) -> None:
        """Lower ``best`` to the first root of F in [a, b] of each ray: split until F' has one sign or no root fits."""
        for _ in range(64):
            keep = a < best[index]
            index, a, b = index[keep], a[keep], b[keep]
            if not len(index):
                return
            o, d = origin[index], direction[index]
            middle = 0.5 * (a + b)
            f_a, u_a, v_a = self._value(o, d, a)
            f_b, u_b, v_b = self._value(o, d, b)
            f_m, _, _ = self._value(o, d, middle)
            speed2 = d[:, 0] ** 2 + d[:, 1] ** 2
            closest = np.where((v_a < 0) & (v_b > 0), u_a - np.square(v_a) / (4 * np.maximum(speed2, 1e-300)), np.inf)
            u_low = np.maximum(np.minimum(np.minimum(u_a, u_b), closest), 0.0)
            u_high = np.maximum(u_a, u_b)
            ends = [np.stack(pair) for pair in zip(self._terms(u_low), self._terms(u_high), strict=True)]
            s_low, s_high = sum(e.min(axis=0) for e in ends), sum(e.max(axis=0) for e in ends)
            products = np.stack([s_low * v_a, s_low * v_b, s_high * v_a, s_high * v_b])
            g_low, g_high = d[:, 2] - products.max(axis=0), d[:, 2] - products.min(axis=0)
            change = (f_a <= 0) != (f_b <= 0)
            monotone = (g_low > 0) | (g_high < 0)
            tiny = (middle <= a) | (middle >= b)
            solve = change & (monotone | tiny)
            if solve.any():
                root = self._bracketed(o[solve], d[solve], a[solve], b[solve], f_a[solve])
                np.minimum.at(best, index[solve], root)
            clear = np.abs(f_m) > np.maximum(np.abs(g_low), np.abs(g_high)) * 0.5 * (b - a) * (1 + 1e-9)
            split = ~(monotone | tiny | clear)
            index = np.concatenate([index[split], index[split]])
            a, b = np.concatenate([a[split], middle[split]]), np.concatenate([middle[split], b[split]])
        raise RuntimeError("asphere search did not end in 64 subdivisions")

    def _bracketed(self, o: Array, d: Array, a: Array, b: Array, f_a: Array) -> Array:
        """Newton kept inside a shrinking bracket; a bisection wherever Newton would leave it."""
        a, b = a.copy(), b.copy()
        below = f_a <= 0
        t = 0.5 * (a + b)
        for _ in range(80):
            f, u, v = self._value(o, d, t)
            left = (f <= 0) == below
            a, b = np.where(left, t, a), np.where(left, b, t)
            slope = d[:, 2] - self.slope_u(u) * v
            with np.errstate(divide="ignore", invalid="ignore"):
                newton = t - f / slope
            step = np.where((newton >= a) & (newton <= b), newton, 0.5 * (a + b))
            if np.all(np.abs(step - t) <= 4e-16 * np.maximum(np.abs(t), self.reach)):
                return step
            t = step
        return t
