"""Writer of STEP files (ISO 10303-21, protocol AP214): exact solids, sheets and polylines of `mistray.analyses.export`.

It writes the part of ISO 10303-42 that CAD programs exchange most: planes, cylinders, cones, spheres and B-splines
within edges, faces and shells, and an assembly of named products. Lengths are in mm, angles in radians.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

from mistray.replace_file import replace_file

Array = npt.NDArray[np.float64]
Colour = tuple[float, float, float]

SCHEMA = "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }"
UNCERTAINTY_MM = 1e-6  # points that are nearer to each other than this are one


def real(value: float) -> str:
    """Return a number as Part 21 requires it, with a decimal point and all its digits."""
    mantissa, letter, exponent = repr(float(value) + 0.0).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.") + (f"E{exponent}" if letter else "")


def text(value: str) -> str:
    """Return a string as Part 21 requires it, in quotes; characters beyond ASCII become their UTF-16 codes."""
    parts = []
    for letter in value:
        if letter in "'\\":
            parts.append(2 * letter)
        elif " " <= letter <= "~":
            parts.append(letter)
        else:
            parts.append(f"\\X2\\{letter.encode('utf-16-be').hex().upper()}\\X0\\")
    return f"'{''.join(parts)}'"


def refs(numbers: Iterable[int]) -> str:
    """Return references to entities as a list in Part 21 syntax, such as ``(#1,#2)``."""
    return f"({','.join(f'#{number}' for number in numbers)})"


def reals(values: Iterable[float]) -> str:
    """Return numbers as a list in Part 21 syntax, such as ``(0.,1.5)``."""
    return f"({','.join(map(real, values))})"


def _grouped(knots: Array) -> tuple[str, str]:
    """Return the multiplicities and the distinct values of a knot vector as two lists in Part 21 syntax."""
    values, counts = np.unique(knots, return_counts=True)
    return f"({','.join(map(str, counts.tolist()))})", reals(values)


class StepFile:
    """
    Entities of a STEP file. Each method that adds one returns its number, by which others refer to it.

    Parameters
    ----------
    name : str
        Name of the top product.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._lines: list[str] = []
        self._styles: dict[tuple[Colour, bool], int] = {}
        self._styled: list[int] = []
        self._products: list[int] = []
        application = self.add("APPLICATION_CONTEXT('automotive design')")
        self.add(f"APPLICATION_PROTOCOL_DEFINITION('international standard','automotive_design',2000,#{application})")
        self._product_context = self.add(f"PRODUCT_CONTEXT('',#{application},'mechanical')")
        self._definition_context = self.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',#{application},'design')")
        mm = self.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
        radian = self.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
        steradian = self.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
        near = self.add(
            f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({real(UNCERTAINTY_MM)}),#{mm},'distance_accuracy_value','')"
        )
        self._space = self.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{near}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT((#{mm},#{radian},#{steradian}))REPRESENTATION_CONTEXT('',''))"
        )
        self._world = self.placement(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))

    def add(self, entity: str) -> int:
        """Add an entity, given as Part 21 text; return its number."""
        self._lines.append(entity)
        return len(self._lines)

    # ---- points and curves

    def point(self, p: Array) -> int:
        """Add a point, (3,) in mm; return its number."""
        return self.add(f"CARTESIAN_POINT('',{reals(p.tolist())})")

    def direction(self, d: Array) -> int:
        """Add a direction, a unit vector (3,); return its number."""
        return self.add(f"DIRECTION('',{reals(d.tolist())})")

    def placement(self, origin: Array, axis: Array, x: Array) -> int:
        """Add a frame, from its origin in mm and unit vectors along its z and x axes; return its number."""
        parts = self.point(origin), self.direction(axis), self.direction(x)
        return self.add(f"AXIS2_PLACEMENT_3D('',#{parts[0]},#{parts[1]},#{parts[2]})")

    def line(self, start: Array, end: Array) -> int:
        """Add the line through two points, (3,) in mm; return its number."""
        along = (end - start) / np.linalg.norm(end - start)
        vector = self.add(f"VECTOR('',#{self.direction(along)},1.)")
        return self.add(f"LINE('',#{self.point(start)},#{vector})")

    def circle(self, placement: int, radius: float) -> int:
        """Add a circle about the z axis of a frame, whose number is `placement`; radius in mm. Return its number."""
        return self.add(f"CIRCLE('',#{placement},{real(radius)})")

    def spline(self, poles: Array, knots: Array, degree: int, weights: Array | None = None) -> int:
        """
        Add a B-spline curve and return its number.

        Parameters
        ----------
        poles : (n, 3) float64
            Control points, mm.
        knots : (n + degree + 1,) float64
            Knot vector, clamped at both ends.
        degree : int
            Degree of the polynomials.
        weights : (n,) float64, optional
            Weights of the control points of a rational curve; None: the curve is not rational.
        """
        points = refs(self.point(pole) for pole in poles)
        counts, values = _grouped(knots)
        if weights is None:
            return self.add(
                f"B_SPLINE_CURVE_WITH_KNOTS('',{degree},{points},.UNSPECIFIED.,.F.,.F.,{counts},{values},.UNSPECIFIED.)"
            )
        return self.add(
            f"(BOUNDED_CURVE()B_SPLINE_CURVE({degree},{points},.UNSPECIFIED.,.F.,.F.)"
            f"B_SPLINE_CURVE_WITH_KNOTS({counts},{values},.UNSPECIFIED.)CURVE()GEOMETRIC_REPRESENTATION_ITEM()"
            f"RATIONAL_B_SPLINE_CURVE({reals(weights.tolist())})REPRESENTATION_ITEM(''))"
        )

    def polyline(self, points: Array, name: str = "") -> int:
        """Add a polyline through points, (n, 3) in mm; return its number."""
        return self.add(f"POLYLINE({text(name)},{refs(self.point(point) for point in points)})")

    # ---- surfaces

    def plane(self, placement: int) -> int:
        """Add the xy plane of a frame, whose number is `placement`; return its number."""
        return self.add(f"PLANE('',#{placement})")

    def cylinder(self, placement: int, radius: float) -> int:
        """Add a cylindrical surface about the z axis of a frame; radius in mm. Return its number."""
        return self.add(f"CYLINDRICAL_SURFACE('',#{placement},{real(radius)})")

    def cone(self, placement: int, radius: float, half_angle: float) -> int:
        """Add a cone that widens along +z of a frame: radius at the origin, mm; half angle, rad. Return its number."""
        return self.add(f"CONICAL_SURFACE('',#{placement},{real(radius)},{real(half_angle)})")

    def sphere(self, placement: int, radius: float) -> int:
        """Add a spherical surface about the origin of a frame; radius in mm. Return its number."""
        return self.add(f"SPHERICAL_SURFACE('',#{placement},{real(radius)})")

    def revolution(self, curve: int, origin: Array, axis: Array) -> int:
        """Add the surface that a curve sweeps about the unit vector `axis` through `origin`, mm; return its number."""
        place = self.add(f"AXIS1_PLACEMENT('',#{self.point(origin)},#{self.direction(axis)})")
        return self.add(f"SURFACE_OF_REVOLUTION('',#{curve},#{place})")

    def spline_surface(self, poles: Array, knots: tuple[Array, Array], degrees: tuple[int, int]) -> int:
        """Add a B-spline surface: control points (m, n, 3), mm, knots and degrees along m and n; return its number."""
        rows = ",".join(refs(self.point(pole) for pole in row) for row in poles)
        (u_counts, u_values), (v_counts, v_values) = map(_grouped, knots)
        return self.add(
            f"B_SPLINE_SURFACE_WITH_KNOTS('',{degrees[0]},{degrees[1]},({rows}),.UNSPECIFIED.,.F.,.F.,.F.,"
            f"{u_counts},{v_counts},{u_values},{v_values},.UNSPECIFIED.)"
        )

    # ---- edges, faces, bodies

    def vertex(self, p: Array) -> int:
        """Add a vertex, (3,) in mm; return its number."""
        return self.add(f"VERTEX_POINT('',#{self.point(p)})")

    def edge(self, start: int, end: int, curve: int) -> int:
        """Add an edge along a curve, from vertex `start` to vertex `end`, all given by number; return its number."""
        return self.add(f"EDGE_CURVE('',#{start},#{end},#{curve},.T.)")

    def loop(self, edges: Sequence[tuple[int, bool]]) -> int:
        """Add a closed loop of edges, each with its number and whether it runs forwards; return the loop's number."""
        oriented = [self.add(f"ORIENTED_EDGE('',*,*,#{edge},{_flag(forwards)})") for edge, forwards in edges]
        return self.add(f"EDGE_LOOP('',{refs(oriented)})")

    def face(self, name: str, surface: int, along: bool, loops: Sequence[int]) -> int:
        """
        Add a face, a part of a surface bounded by loops; return its number.

        Parameters
        ----------
        name : str
            Name of the face.
        surface : int
            Number of the surface that carries the face.
        along : bool
            Whether the normal of the face is that of the surface.
        loops : sequence of int
            Numbers of the bounding loops, counter-clockwise about the normal of the face; the outer loop first.
        """
        kinds = ["FACE_OUTER_BOUND", *["FACE_BOUND"] * (len(loops) - 1)]
        bounds = [self.add(f"{kind}('',#{loop},.T.)") for kind, loop in zip(kinds, loops, strict=True)]
        return self.add(f"ADVANCED_FACE({text(name)},{refs(bounds)},#{surface},{_flag(along)})")

    def solid(self, name: str, faces: Sequence[int]) -> int:
        """Add a body bounded by faces, given by number, whose normals point outwards; return its number."""
        shell = self.add(f"CLOSED_SHELL('',{refs(faces)})")
        return self.add(f"MANIFOLD_SOLID_BREP({text(name)},#{shell})")

    def sheets(self, name: str, faces: Sequence[int]) -> int:
        """Add faces, given by number, that enclose no body; return the number of their surface model."""
        shells = [self.add(f"OPEN_SHELL('',(#{face}))") for face in faces]
        return self.add(f"SHELL_BASED_SURFACE_MODEL({text(name)},{refs(shells)})")

    def curves(self, name: str, curves: Sequence[int]) -> int:
        """Add a set of curves, given by number; return its number."""
        return self.add(f"GEOMETRIC_CURVE_SET({text(name)},{refs(curves)})")

    def paint(self, item: int, colour: Colour, line: bool = False) -> None:
        """Set the colour, red, green and blue, 0 … 1, of a body, sheets or (with `line`) curves with number `item`."""
        style = self._styles.get((colour, line))
        if style is None:
            rgb = self.add(f"COLOUR_RGB('',{','.join(map(real, colour))})")
            if line:
                font = self.add("DRAUGHTING_PRE_DEFINED_CURVE_FONT('continuous')")
                own = self.add(f"CURVE_STYLE('',#{font},POSITIVE_LENGTH_MEASURE(0.1),#{rgb})")
            else:
                fill = self.add(f"FILL_AREA_STYLE_COLOUR('',#{rgb})")
                filled = self.add(f"FILL_AREA_STYLE('',(#{fill}))")
                area = self.add(f"SURFACE_STYLE_FILL_AREA(#{filled})")
                side = self.add(f"SURFACE_SIDE_STYLE('',(#{area}))")
                own = self.add(f"SURFACE_STYLE_USAGE(.BOTH.,#{side})")
            style = self._styles[colour, line] = self.add(f"PRESENTATION_STYLE_ASSIGNMENT((#{own}))")
        self._styled.append(self.add(f"STYLED_ITEM('',(#{style}),#{item})"))

    # ---- products

    def part(self, name: str, kind: str, items: Sequence[int]) -> tuple[int, int]:
        """
        Add a product, a named part with its bodies, sheets or curves.

        Parameters
        ----------
        name : str
            Name of the product.
        kind : str
            Kind of representation: "ADVANCED_BREP", "MANIFOLD_SURFACE" or "GEOMETRICALLY_BOUNDED_WIREFRAME"; "": the
            general kind, for a product without geometry of its own, as an assembly.
        items : sequence of int
            Numbers of the bodies, sheets or curve sets.

        Returns
        -------
        definition, representation : int
            Numbers of the product definition and of its shape representation.
        """
        entity = f"{kind}_SHAPE_REPRESENTATION" if kind else "SHAPE_REPRESENTATION"
        shape = self.add(f"{entity}({text(name)},{refs([self._world, *items])},#{self._space})")
        product = self.add(f"PRODUCT({text(name)},{text(name)},'',(#{self._product_context}))")
        self._products.append(product)
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
        definition = self.add(f"PRODUCT_DEFINITION('design','',#{formation},#{self._definition_context})")
        owner = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION(#{owner},#{shape})")
        return definition, shape

    def assembly(self, name: str, parts: Sequence[tuple[str, tuple[int, int]]]) -> tuple[int, int]:
        """Add a product made of named parts at the places of their own coordinates; return numbers as `part` does."""
        definition, shape = self.part(name, "", ())
        same = self.add(f"ITEM_DEFINED_TRANSFORMATION('','',#{self._world},#{self._world})")
        for own, (part, part_shape) in parts:
            use = self.add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE({text(own)},{text(own)},'',#{definition},#{part},$)")
            owner = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{use})")
            relation = self.add(
                f"(REPRESENTATION_RELATIONSHIP('','',#{part_shape},#{shape})"
                f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{same})SHAPE_REPRESENTATION_RELATIONSHIP())"
            )
            self.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{relation},#{owner})")
        return definition, shape

    def write(self, path: str | Path) -> Path:
        """
        Write the STEP file and return its path.

        Raises
        ------
        MistrayError
            If the file cannot be written.
        """
        self.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,{refs(self._products)})")
        if self._styled:
            self.add(f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',{refs(self._styled)},#{self._space})")
        program = text(f"mistray {version('mistray')}")
        now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
        head = [
            "ISO-10303-21;",
            "HEADER;",
            "FILE_DESCRIPTION((''),'2;1');",
            f"FILE_NAME({text(self.name)},'{now}',(''),(''),{program},{program},'');",
            f"FILE_SCHEMA(('{SCHEMA}'));",
            "ENDSEC;",
            "DATA;",
        ]
        body = [f"#{number}={line};" for number, line in enumerate(self._lines, start=1)]
        return replace_file(path, "\n".join([*head, *body, "ENDSEC;", "END-ISO-10303-21;", ""]), "STEP file")


def _flag(value: bool) -> str:
    return ".T." if value else ".F."
