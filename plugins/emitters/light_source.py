"""Base class of light sources, for mistray's plugins and for those of users."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from mistray.errors import MistrayError
from mistray.param import OBJECT, REQUIRED, Param, fixed
from mistray.physics.geometry.pose import pointing_error, rigid_motion
from mistray.physics.polarization.state import polarization_state
from mistray.ranges import AZIMUTH_DEG, FIELD_DEG, FINITE, POSITIVE, TEXT, WAVELENGTH_NM, WEIGHT, Range
from mistray.sampling.source import EmittedRays, SceneSource, SourceRequest
from mistray.spectra.spectrum import (
    BANDS,
    DEFAULT_BAND_NM,
    DEFAULT_BANDS,
    DEFAULT_NM,
    SpectrumSamples,
    light_of,
    of_lines,
)
from mistray.surfaces.upload import changed_numbers

BAND = {
    "band_nm": fixed(
        "nm",
        WAVELENGTH_NM,
        "two wavelengths, rising: the traced band of a continuous spectrum; by default of a table all of it",
        None,
        otherwise="{:g}, {:g}".format(*DEFAULT_BAND_NM),
    ),
    "bands": fixed("1", BANDS, "number of equal parts in which the band is traced", None, otherwise=f"{DEFAULT_BANDS}"),
}
SPECTRUM = {
    "wavelength_nm": fixed("nm", WAVELENGTH_NM, 'one value or a list, "486.1, 587.6, 656.3"', DEFAULT_NM),
    "weights": fixed("1", WEIGHT, "one weight for each wavelength; normalised", None, otherwise="equal"),
    "spectrum": fixed(
        "string",
        TEXT,
        'spectrum instead of wavelength_nm: lines "F d C", blackbody:3000, am0, d65 or a .csv file',
        None,
        within="see docs/sources.md",
    ),
    **BAND,
}
DIRECTION = {
    "field_deg": fixed("degree", FIELD_DEG, "angle of the axis from z of ``to_world``", 0.0),
    "azimuth_deg": fixed("degree", AZIMUTH_DEG, "azimuth of the axis about z, from +y towards -x", 0.0),
}
POLARIZATION = {
    "stokes": fixed("1", TEXT, 'polarised light: "s1, s2, s3" over S0', None, within="see docs/polarization.md"),
    "jones": fixed("1", TEXT, 'polarised light: "ex, ey"', None, within="see docs/polarization.md"),
    "polarization_deg": fixed("degree", AZIMUTH_DEG, "polarised light: the angle of linear polarisation", None),
}
FRAME = {"to_world": fixed("mm", OBJECT, "the pivot and the axes", within="rigid", otherwise="identity")}
# Parameters of all sources
LIGHT = {**DIRECTION, **SPECTRUM, **POLARIZATION, **FRAME}
TILT = Param("degree", FINITE, "tilts of the axis of its light, which is +z", default=0.0, absolute=0.1)


class LightSource(mi.Emitter):
    """
    Source of light with a position, an axis and wavelengths.

    A subclass becomes a plugin by registration, ``mi.register_emitter("name", Name)``. Every source has the properties
    ``field_deg``, ``azimuth_deg``, ``wavelength_nm``, ``weights`` and ``to_world`` of `collimated`. Its axis is
    Rz(``azimuth_deg``) · (0, sin θ, cos θ) with θ = ``field_deg``. It may be polarised by ``stokes``, ``jones`` or
    ``polarization_deg``, see docs/polarization.md. A subclass defines the members below. It is then traced, recorded
    and drawn, and has derivatives with respect to the parameters in `differentiable`, edges included.

    Attributes
    ----------
    properties : mapping of str to Param
        All that a scene may give, by name, with `LIGHT`; of plugins with a manual.
    numbers : mapping of str to Param
        Its numeric parameters, from which the four following attributes are made; a subclass states either.
    ranges : mapping of str to Range
        Its numeric parameters with their allowed ranges; those without an entry in `defaults` are required.
    defaults : mapping of str to float
        Default values of numeric parameters.
    differentiable : tuple of str
        Names of the parameters for which `motion` gives derivatives.
    tolerances : mapping of str to float
        Tolerances of these parameters, half the width of the range that a workshop holds.
    extended : bool
        Whether its rays start from more than one point, see `rays_from`.
    precise : bool
        Whether `rays_from` takes float64 points and values, so that a narrow cone can be aimed from afar.
    values : dict of str to float
        Values of its numeric parameters, by name.
    light : SpectrumSamples
        Vacuum wavelengths, nm, and their weights.
    matrix : (4, 4) float64
        Exactly rigid transform from the frame of ``to_world`` to the world, mm.
    pointing_error : float
        Error of the axis direction in ``to_world``, rad.
    stokes : tuple of three float or None
        State of polarisation with respect to the axes u and direction × u of `frame`; None if unpolarised.
    """

    properties: ClassVar[Mapping[str, Param]]
    numbers: ClassVar[Mapping[str, Param]] = {}
    ranges: ClassVar[Mapping[str, Range]] = {}
    defaults: ClassVar[Mapping[str, float]] = {}
    differentiable: ClassVar[tuple[str, ...]] = ()
    tolerances: ClassVar[Mapping[str, float]] = {}
    extended: ClassVar[bool] = False
    precise: ClassVar[bool] = False

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if numbers := vars(cls).get("numbers"):
            cls.ranges = {key: param.values for key, param in numbers.items()}
            cls.defaults = {key: param.default for key, param in numbers.items() if param.default is not REQUIRED}
            cls.differentiable = tuple(key for key, param in numbers.items() if param.moves)
            cls.tolerances = {key: param.absolute for key, param in numbers.items() if param.absolute is not None}

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = +mi.EmitterFlags.DeltaPosition
        self.name = str(props.id())
        self.owner = f"source '{self.name}'"
        missing = [key for key in self.ranges if key not in props and key not in self.defaults]
        if missing:
            raise MistrayError(f"{self.owner}: {', '.join(missing)} is missing; add what is required")
        self.values = {
            key: float(within.check(key, props.get(key, self.defaults.get(key)), self.owner))
            for key, within in self.ranges.items()
        }
        self._loaded = dict(self.values)
        self.field_deg, self.azimuth_deg = (param.of(props, key, self.owner) for key, param in DIRECTION.items())
        to_world = props.get("to_world", mi.ScalarTransform4f()).matrix
        self.matrix, self.pointing_error = rigid_motion(to_world, self.owner), pointing_error(to_world)
        self.light = self._light(props)
        self.wavelengths_nm, self.weights = self.light.wavelengths_nm, self.light.weights
        self.states_light = any(key in props for key in ("wavelength_nm", "spectrum"))
        self.parameters = {key: mi.Float(self.values[key]) for key in self.differentiable}
        self.stokes = polarization_state(self.owner, **{key: props[key] for key in POLARIZATION if key in props})

    def _light(self, props: mi.Properties) -> SpectrumSamples:
        """
        Return the source's wavelengths and weights, from its spectrum or from ``wavelength_nm`` and ``weights``.

        Raise `MistrayError` if properties of the scene do not go together, or a value is not valid.
        """
        given = {key: self._numbers(key, props[key]) for key in ("wavelength_nm", "weights") if key in props}
        band, bands = self._band(props)
        try:
            if "spectrum" in props:
                if "wavelength_nm" in given:
                    self._fail("wavelength_nm and spectrum are given; give one of them")
                text = SPECTRUM["spectrum"].of(props, "spectrum", self.owner)
                file = str(mi.file_resolver().resolve(text)) if text.strip().lower().endswith(".csv") else text
                return light_of(file, band, bands, given.get("weights"))
            if band is not None or bands is not None:
                self._fail("band_nm or bands is given without spectrum; give both")
            return of_lines(given.get("wavelength_nm", [DEFAULT_NM]), given.get("weights"))
        except MistrayError as error:
            raise MistrayError(f"{self.owner}: {str(error).removeprefix(f'{self.owner}: ')}") from None

    def _band(self, props: mi.Properties) -> tuple[list[float] | None, int | None]:
        """Return the limits ``band_nm`` (nm) and the number of ``bands``; None for what is not given."""
        band = self._numbers("band_nm", props["band_nm"]) if "band_nm" in props else None
        return band, BAND["bands"].of(props, "bands", self.owner)

    def check(self) -> None:
        """
        Raise `MistrayError` if numbers in `values`, each in its range, do not go together; in the base class they do.

        Updates call it. A subclass with such a condition calls it from its constructor as well.
        """

    @property
    def polarized(self) -> bool:
        """True if the light is polarised."""
        return self.stokes is not None

    def power(self, field_deg: float | None = None) -> float:
        """Return the emitted flux, W, at a field angle, degrees; None: the source's own."""
        raise NotImplementedError

    def rays(self, sample: mi.Point2f, rng: mi.PCG32, n: Mapping[str, mi.Float]) -> tuple[mi.Vector3f, mi.Vector3f]:
        """
        Return origins, mm, and directions of rays of equal flux, in the frame of the source, whose z is its axis.

        Parameters
        ----------
        sample : mi.Point2f
            Points of the unit square; neighbouring points must give neighbouring rays.
        rng : mi.PCG32
            Random numbers for rays that need more than two.
        n : mapping of str to mi.Float
            Parameters of `values` by name, and ``wavelength_nm``, nm.
        """
        raise NotImplementedError

    def rays_from(
        self, place: mi.Point2f, sample: mi.Point2f, rng: mi.PCG32, n: Mapping[str, mi.Float]
    ) -> tuple[mi.Vector3f, mi.Vector3f]:
        """
        Return origins, mm, and directions of rays of an extended source, as `rays` does.

        A trace aims the rays of a source at the scene if the source also has a method ``density(place, d, n)``. It
        gives the density of the directions d, in its own frame, 1/sr, from the start point that belongs to a point of
        the unit square.

        Parameters
        ----------
        place : mi.Point2f
            Point of the unit square that determines where a ray starts.
        sample : mi.Point2f
            Point of the unit square that determines the direction of a ray.
        rng, n
            Parameters of `rays`.
        """
        return self.rays(sample, rng, n)

    def edge_samples(self, count: int, within: float) -> np.ndarray | None:
        """
        Return points of the unit square, (2, count), whose rays lie along the edge of the light.

        They must lie inside the edge by a fraction `within` of its size, and go around once. None: the light has no
        such edge, because it fades out or fills the scene. Rims along which an edge runs have no derivative, and
        `mistray.gradient` reports that.
        """
        return None

    @property
    def pupil_share(self) -> float:
        """Fraction of the light that counts as launched in relative results, 0 … 1."""
        return 1.0

    def motion(self, name: str, o: mi.Vector3d, d: mi.Vector3d) -> tuple[mi.Vector3d, mi.Vector3d]:
        """
        Return the derivatives of ray origins o, mm, and directions d with respect to a parameter of the source.

        Origins and directions are in the frame of the source, and derivatives hold it fixed. They are per unit of the
        parameter `name`.
        """
        raise NotImplementedError

    def frame(self, field_deg: float | None = None, azimuth_deg: float | None = None) -> tuple[np.ndarray, ...]:
        """
        Return position and axes of the source in the world at a field angle and azimuth, degrees; None: its own.

        Returns
        -------
        pivot, direction, u, v : (3,) float64
            Origin of its frame, mm; unit vector along its axis; and unit vectors of the axes across it.
        """
        theta = np.radians(self.field_deg if field_deg is None else field_deg)
        phi = np.radians(self.azimuth_deg if azimuth_deg is None else azimuth_deg)
        c, s = np.cos(phi), np.sin(phi)
        spin = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        direction = spin @ [0.0, np.sin(theta), np.cos(theta)]
        u = spin @ [1.0, 0.0, 0.0]
        v = spin @ [0.0, np.cos(theta), -np.sin(theta)]
        rotation = self.matrix[:3, :3]
        return self.matrix[:3, 3], rotation @ direction, rotation @ u, rotation @ v

    def field_of(self, height_mm: float) -> float:
        """
        Return the field angle, degrees, for an object height, mm.

        The base class has no object plane and raises `MistrayError`.
        """
        raise MistrayError(f"{self.owner}: its light comes from infinity; give its field in degrees")

    def sources(self, request: SourceRequest) -> Sequence[SceneSource]:
        """Return the sources that a trace starts, one for each wavelength."""
        pivot, direction, u, v = self.frame(request.field_deg, request.azimuth_deg)
        return [
            self.source(
                request,
                emitter=self,
                name=request.name,
                wavelength_nm=float(wavelength),
                power=self.power(request.field_deg) * share,
                pivot=pivot,
                direction=direction,
                u=u,
                v=v,
            )
            for wavelength, share in zip(request.wavelengths_nm, request.weights, strict=True)
        ]

    def source(self, request: SourceRequest, **facts: Any) -> SceneSource:
        """Return the start ray source of a trace at one wavelength; `facts` are fields of `SceneSource` by name."""
        return EmittedRays(scene=request.scene, **facts)

    def _keep_parameters(self, names: Container[str]) -> None:
        """Restrict the differentiable parameters to the given names."""
        self.differentiable = tuple(key for key in self.differentiable if key in names)  # type: ignore[misc]
        self.parameters = {key: mi.Float(self.values[key]) for key in self.differentiable}

    def _fail(self, what: str) -> None:
        raise MistrayError(f"{self.owner}: {what}")

    def _flux_given(self, props: mi.Properties, names: Sequence[str]) -> tuple[str, float]:
        """
        Return name and value of the quantity in the scene that sets the flux; by default the first of `names`, 1.

        Raise `MistrayError` if the scene gives more than one, or a value that is not positive.
        """
        found = [key for key in names if key in props]
        if len(found) > 1:
            self._fail(f"{' and '.join(found)} are given; give one of them")
        key = found[0] if found else names[0]
        return key, float(POSITIVE.check(key, props.get(key, 1.0), self.owner))

    def _numbers(self, key: str, value: object) -> list[float]:
        text = str(value).strip(" ,")
        try:  # nothing between two commas is no number
            found = [float(one) for part in text.split(",") for one in part.split() or ("",)] if text else []
        except ValueError:
            self._fail(f"{key} is '{value}'; give one number or a list separated by commas")
        return [float(SPECTRUM[key].check(key, number, self.owner)) for number in found]

    def traverse(self, callback: mi.TraversalCallback) -> None:
        for key, value in self.parameters.items():
            callback.put(key, value, mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous)

    def parameters_changed(self, keys: list[str] = []) -> None:  # noqa: B006  (Mitsuba's own signature)
        before, changed = self.values, dict.fromkeys(self.parameters, 0.0)
        try:
            changed = changed_numbers(self.parameters, self.owner, before, self._loaded)
            self.values = before | changed
            for key, value in changed.items():
                self.ranges[key].check(key, value, self.owner)
            self.check()
        except MistrayError:
            self.values = before
            for key in changed:  # in place: mi.traverse has handed out these very objects
                mi.set_property(self.parameters[key], mi.Float(before[key]))
            raise

    # Mitsuba's own protocol, for its particle tracer

    def sample_ray(
        self, time: mi.Float, sample1: mi.Float, sample2: mi.Point2f, sample3: mi.Point2f, active: mi.Mask = True
    ) -> tuple[mi.Ray3f, mi.Spectrum]:
        """Return start rays in the world, and their whole flux, W; 0 for a source whose rays depend on the scene."""
        kind = type(self)
        if kind.rays_from is LightSource.rays_from and kind.rays is LightSource.rays:
            return dr.zeros(mi.Ray3f, dr.width(sample2)), mi.Spectrum(0)
        pivot, *axes = (mi.Vector3f(*vector.tolist()) for vector in self.frame())
        numbers = {name: mi.Float(value) for name, value in self.values.items()}
        numbers["wavelength_nm"] = mi.Float(float(self.wavelengths_nm[0]))
        o, d = self.rays_from(sample3, sample2, mi.PCG32(size=dr.width(sample2)), numbers)
        direction, u, v = axes
        ray = dr.zeros(mi.Ray3f, dr.width(sample2))
        ray.o = mi.Point3f(pivot + u * o.x + v * o.y + direction * o.z)
        ray.d = dr.normalize(u * d.x + v * d.y + direction * d.z)
        ray.maxt = dr.largest(mi.Float)
        ray.time = time
        return ray, mi.Spectrum(self.power())

    def sample_wavelengths(  # type: ignore[no-untyped-def]
        self, si: mi.SurfaceInteraction3f, sample: mi.Float, active: mi.Mask = True
    ):
        # Mitsuba's RGB and mono variants carry no wavelength; the spectral ones get the first of the source
        wavelengths = dr.zeros(type(si.wavelengths), dr.width(sample))
        if mi.is_spectral:
            wavelengths += float(self.wavelengths_nm[0])
        return wavelengths, mi.Spectrum(self.power())

    def sample_position(
        self, time: mi.Float, sample: mi.Point2f, active: mi.Mask = True
    ) -> tuple[mi.PositionSample3f, mi.Float]:
        # A camera does not see a source that is no surface
        return dr.zeros(mi.PositionSample3f, dr.width(sample)), mi.Float(0)

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: mi.Mask = True
    ) -> tuple[mi.DirectionSample3f, mi.Spectrum]:
        """
        Return a sample without light to integrators that look for the source from a surface point.

        Subclasses may override this.
        """
        return dr.zeros(mi.DirectionSample3f, dr.width(it)), mi.Spectrum(0)

    def pdf_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Mask = True) -> mi.Float:
        return mi.Float(0)

    def eval_direction(self, it: mi.Interaction3f, ds: mi.DirectionSample3f, active: mi.Mask = True) -> mi.Spectrum:
        return mi.Spectrum(0)

    def pdf_position(self, ps: mi.PositionSample3f, active: mi.Mask = True) -> mi.Float:
        return mi.Float(0)

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Mask = True) -> mi.Spectrum:
        return mi.Spectrum(0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return mi.ScalarBoundingBox3f()

    def to_string(self) -> str:
        wavelengths = ", ".join(f"{value:g}" for value in self.wavelengths_nm)
        own = "".join(f"{key} = {value:g}, " for key, value in self.values.items())
        return f"{type(self).__name__}[{own}field = {self.field_deg:g} deg, {self.power():g} W, {wavelengths} nm]"


def tilted_axes(n: Mapping[str, Any]) -> tuple[mi.Vector3d, mi.Vector3d, mi.Vector3d]:
    """Return axes of a frame tilted by ``tilt_x`` and ``tilt_y`` (degrees), the columns of Rx(tilt_x) Ry(tilt_y)."""
    (sx, cx), (sy, cy) = (dr.sincos(dr.deg2rad(mi.Float64(n[key]))) for key in ("tilt_x", "tilt_y"))
    return mi.Vector3d(cy, sx * sy, -cx * sy), mi.Vector3d(0, cx, sx), mi.Vector3d(sy, -sx * cy, cx * cy)


def out_of(axes: tuple[mi.Vector3d, mi.Vector3d, mi.Vector3d], vector: mi.Vector3d) -> mi.Vector3d:
    """Return a vector given by components along three axes, in the frame in which these axes are stated."""
    return axes[0] * vector.x + axes[1] * vector.y + axes[2] * vector.z


def tilt_motion(name: str, axes: tuple[mi.Vector3d, mi.Vector3d, mi.Vector3d], vector: mi.Vector3d) -> mi.Vector3d:
    """
    Return the derivative of a vector that turns with a tilted frame, per degree of ``tilt_x`` or ``tilt_y``.

    `axes` are those of `tilted_axes`; `vector` is given in the frame in which they are stated.
    """
    about = mi.Vector3d(1, 0, 0) if name == "tilt_x" else axes[1]
    return dr.cross(about * (dr.pi / 180), vector)
