"""Writes the STEP files of tests/data, by ISO 10303-42 and -44 in the schema AUTOMOTIVE_DESIGN of AP 214.

    python tests/data/make_step.py

``vane_tube.step`` is a tube with vanes in one piece, in mm, as a lathe would leave it. ``assembly_inch.step`` is an
assembly in inches: one ring that stands in it twice, once turned, and a bracket that is no body of revolution.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

Profile = Sequence[tuple[float, float]]
Vector = tuple[float, float, float]
INCH_MM = 25.4

TUBE_INNER, TUBE_OUTER, TUBE_LENGTH = 20.0, 22.0, 80.0
VANE_RADII = (12.0, 12.0, 12.0)
VANE_FRONTS = (10.0, 34.0, 58.0)
VANE_THICKNESS, VANE_BEVEL = 1.5, 1.0


def vane_tube_profile() -> list[tuple[float, float]]:
    """(r, z) of the tube, once around the body: the axis is the light's, z = 0 the opening, vanes bevelled behind."""
    points = [(TUBE_OUTER, 0.0), (TUBE_INNER, 0.0)]
    for radius, z in zip(VANE_RADII, VANE_FRONTS, strict=True):
        behind = z + VANE_THICKNESS
        points += [(TUBE_INNER, z), (radius, z), (radius + VANE_BEVEL, behind), (TUBE_INNER, behind)]
    return [*points, (TUBE_INNER, TUBE_LENGTH), (TUBE_OUTER, TUBE_LENGTH)]


class Step:
    """The DATA section of a STEP file."""

    def __init__(self, unit: str = "mm") -> None:
        self.lines: list[str] = []
        self.unit = unit
        self.application = self.add("APPLICATION_CONTEXT('automotive design')")
        self.context = self._context()

    def add(self, entity: str) -> str:
        """Append an entity; its name ``#n``."""
        self.lines.append(f"#{len(self.lines) + 1}={entity};")
        return f"#{len(self.lines)}"

    def _context(self) -> str:
        millimetre = self.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
        length = millimetre
        if self.unit == "inch":
            factor = self.add(f"LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE({INCH_MM}),{millimetre})")
            sizes = self.add("DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.)")
            length = self.add(f"(CONVERSION_BASED_UNIT('INCH',{factor})LENGTH_UNIT()NAMED_UNIT({sizes}))")
        angle = self.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
        solid = self.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
        error = self.add(f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-6),{length},'distance_accuracy_value','')")
        return self.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({error}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid}))REPRESENTATION_CONTEXT('',''))"
        )

    def point(self, *xyz: float) -> str:
        return self.add(f"CARTESIAN_POINT('',({_numbers(xyz)}))")

    def direction(self, *xyz: float) -> str:
        return self.add(f"DIRECTION('',({_numbers(xyz)}))")

    def frame(self, origin: Vector, z: Vector = (0.0, 0.0, 1.0), x: Vector = (1.0, 0.0, 0.0)) -> str:
        """An axis placement."""
        return self.add(f"AXIS2_PLACEMENT_3D('',{self.point(*origin)},{self.direction(*z)},{self.direction(*x)})")

    def vertex(self, *xyz: float) -> str:
        return self.add(f"VERTEX_POINT('',{self.point(*xyz)})")

    def line(self, a: str, b: str, start: Vector, end: Vector) -> str:
        """Straight edge from one vertex to another."""
        length = math.dist(start, end)
        unit = [(q - p) / length for p, q in zip(start, end, strict=True)]
        vector = self.add(f"VECTOR('',{self.direction(*unit)},1.)")
        curve = self.add(f"LINE('',{self.point(*start)},{vector})")
        return self.add(f"EDGE_CURVE('',{a},{b},{curve},.T.)")

    def arc(self, a: str, b: str, r: float, z: float) -> str:
        """Edge along a circle about the z axis, counterclockwise from one vertex to another, or to itself."""
        curve = self.add(f"CIRCLE('',{self.frame((0.0, 0.0, z))},{_number(r)})")
        return self.add(f"EDGE_CURVE('',{a},{b},{curve},.T.)")

    def loop(self, *edges: tuple[str, bool], outer: bool = True) -> str:
        """A bound of a face: edges, each with whether it is walked forwards."""
        turned = [self.add(f"ORIENTED_EDGE('',*,*,{edge},{'.T.' if along else '.F.'})") for edge, along in edges]
        ring = self.add(f"EDGE_LOOP('',({','.join(turned)}))")
        return self.add(f"{'FACE_OUTER_BOUND' if outer else 'FACE_BOUND'}('',{ring},.T.)")

    def face(self, bounds: Sequence[str], surface: str, same: bool, name: str = "") -> str:
        """A face; `same`: its outward normal is that of the surface."""
        return self.add(f"ADVANCED_FACE('{name}',({','.join(bounds)}),{surface},{'.T.' if same else '.F.'})")

    def solid_of_revolution(self, profile: Profile, pieces: int = 1) -> str:
        """
        A solid about the z axis.

        The profile is a closed polygon in (r, z) with r > 0, walked so that the body lies to its left when r points
        right and z up. Each side makes a face (`pieces` = 1, a seam at y = 0) or two half ones (`pieces` = 2).
        """
        angles = [2 * math.pi * k / pieces for k in range(pieces)]
        corners = [[(r * math.cos(a), r * math.sin(a), z) for a in angles] for r, z in profile]
        corners = [[(round(x, 12), round(y, 12), z) for x, y, z in ring] for ring in corners]
        vertices = [[self.vertex(*xyz) for xyz in ring] for ring in corners]
        arcs = [
            [self.arc(ring[k], ring[(k + 1) % pieces], r, z) for k in range(pieces)]
            for ring, (r, z) in zip(vertices, profile, strict=True)
        ]
        order = list(range(len(profile)))
        faces = []
        for i, j in pairwise([*order, 0]):
            (r0, z0), (r1, z1) = profile[i], profile[j]
            if z0 == z1:
                surface = self.add(f"PLANE('',{self.frame((0.0, 0.0, z0))})")
                up = r1 < r0  # the body lies to the left
                inner, outer = (j, i) if up else (i, j)
                bounds = [
                    self.loop(*[(edge, up) for edge in (arcs[outer] if up else arcs[outer][::-1])]),
                    self.loop(*[(edge, not up) for edge in (arcs[inner][::-1] if up else arcs[inner])], outer=False),
                ]
                faces.append(self.face(bounds, surface, up))
                continue
            low, high = (i, j) if z1 > z0 else (j, i)
            (ra, za), (rb, zb) = profile[low], profile[high]
            narrow, turned = ((rb, zb), (0.0, 0.0, -1.0)) if rb < ra else ((ra, za), (0.0, 0.0, 1.0))
            place = f"{self.frame((0.0, 0.0, narrow[1]), turned)},{_number(narrow[0])}"
            half = math.atan2(abs(rb - ra), zb - za)
            kind = f"CONICAL_SURFACE('',{place},{_number(half)})" if half else f"CYLINDRICAL_SURFACE('',{place})"
            surface = self.add(kind)
            sides = [
                self.line(vertices[low][k], vertices[high][k], corners[low][k], corners[high][k]) for k in range(pieces)
            ]
            outward = z1 > z0  # the body lies to the left: walked upwards, the outside is away from the axis
            for k in range(pieces):
                following = sides[(k + 1) % pieces]
                around = [(arcs[low][k], True), (following, True), (arcs[high][k], False), (sides[k], False)]
                if not outward:
                    around = [(edge, not along) for edge, along in around[::-1]]
                faces.append(self.face([self.loop(*around)], surface, outward))
        shell = self.add(f"CLOSED_SHELL('',({','.join(faces)}))")
        return self.add(f"MANIFOLD_SOLID_BREP('',{shell})")

    def box(self, low: Vector, high: Vector) -> str:
        """A block along the axes."""
        corner = [tuple((low, high)[(n >> axis) & 1][axis] for axis in range(3)) for n in range(8)]
        vertex = [self.vertex(*xyz) for xyz in corner]
        edges: dict[tuple[int, int], str] = {}
        for n in range(8):
            for axis in range(3):
                m = n | (1 << axis)
                if m != n:
                    edges[n, m] = self.line(vertex[n], vertex[m], corner[n], corner[m])
        faces = []
        for axis in range(3):
            u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
            for side in (0, 1):
                base = side << axis
                round_trip = [base, base | u, base | u | v, base | v]
                if not side:
                    round_trip.reverse()
                walked = [(edges[min(a, b), max(a, b)], a < b) for a, b in pairwise([*round_trip, round_trip[0]])]
                normal, x = (tuple(float(k == along % 3) for k in range(3)) for along in (axis, axis + 1))
                plane = self.add(f"PLANE('',{self.frame(corner[base], normal, x)})")
                faces.append(self.face([self.loop(*walked)], plane, bool(side)))
        shell = self.add(f"CLOSED_SHELL('',({','.join(faces)}))")
        return self.add(f"MANIFOLD_SOLID_BREP('',{shell})")

    def product(self, name: str, solid: str | None = None) -> tuple[str, str, str]:
        """A product: its definition, its shape representation, and the placement at its origin."""
        frame = self.add(f"PRODUCT_CONTEXT('',{self.application},'mechanical')")
        product = self.add(f"PRODUCT('{name}','{name}','',({frame}))")
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',{product})")
        design = self.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{self.application},'design')")
        definition = self.add(f"PRODUCT_DEFINITION('design','',{formation},{design})")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
        origin = self.frame((0.0, 0.0, 0.0))
        kind, items = ("ADVANCED_BREP_SHAPE", f"{origin},{solid}") if solid else ("SHAPE", origin)
        representation = self.add(f"{kind}_REPRESENTATION('{name}',({items}),{self.context})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{representation})")
        return definition, representation, origin

    def place(self, parent: tuple[str, str, str], child: tuple[str, str, str], name: str, *frame: Vector) -> None:
        """An instance of a product within another, at a frame (origin, z, x)."""
        target = self.frame(*frame)
        # The parent's representation owns the placement that its transformation refers to
        definition = parent[1]
        index = int(definition[1:]) - 1
        self.lines[index] = self.lines[index].replace("),#", f",{target}),#", 1)
        move = self.add(f"ITEM_DEFINED_TRANSFORMATION('','',{child[2]},{target})")
        relation = self.add(
            f"(REPRESENTATION_RELATIONSHIP('','',{child[1]},{parent[1]})"
            f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION({move})SHAPE_REPRESENTATION_RELATIONSHIP())"
        )
        usage = self.add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{name}','{name}','',{parent[0]},{child[0]},$)")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',{usage})")
        self.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION({relation},{shape})")

    def text(self, name: str) -> str:
        """The whole file."""
        head = [
            "ISO-10303-21;",
            "HEADER;",
            "FILE_DESCRIPTION(('bodies of revolution, written by tests/data/make_step.py'),'2;1');",
            f"FILE_NAME('{name}','2026-01-01T00:00:00',(''),(''),'','','');",
            "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));",
            "ENDSEC;",
            "DATA;",
        ]
        return "\n".join([*head, *self.lines, "ENDSEC;", "END-ISO-10303-21;", ""])


def vane_tube(pieces: int = 1) -> str:
    """The tube with vanes as STEP text."""
    step = Step()
    step.product("vane tube", step.solid_of_revolution(vane_tube_profile()[::-1], pieces))
    return step.text("vane_tube.step")


def assembly() -> str:
    """Two rings and a bracket as STEP text, in inches."""
    step = Step("inch")
    ring = step.solid_of_revolution([(1.0, 0.0), (1.5, 0.0), (1.5, 0.25), (1.25, 0.25)])
    parts = step.product("ring", ring), step.product("bracket", step.box((-1.0, -2.0, 0.0), (1.0, -1.75, 3.0)))
    whole = step.product("mount")
    step.place(whole, parts[0], "ring_front", (0.0, 0.0, 0.5), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    step.place(whole, parts[0], "ring_side", (0.0, 2.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    step.place(whole, parts[1], "bracket", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    return step.text("assembly_inch.step")


FILES = {"vane_tube.step": vane_tube, "assembly_inch.step": assembly}


def _number(value: float) -> str:
    text = repr(float(value))
    return text.replace("e", "E") if "." in text else text.replace("e", ".E")


def _numbers(values: Sequence[float]) -> str:
    return ",".join(_number(value) for value in values)


if __name__ == "__main__":
    for file, make in FILES.items():
        (Path(__file__).parent / file).write_text(make(), encoding="ascii")
